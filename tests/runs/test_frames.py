"""Raw, flat and dark images that the store keeps when it is asked to."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.runs import acquire_to_store, machine_frames, verify
from twinct.scan import ScanStore, SimulationBuilder, local_rig
from twinct.scenario import Scenario

KEYS = [
    *("cell={kind: gantry}", "trajectory.views=3", "detector.lag=0.2"),
    "source.photons_per_mm2_mas=1e5",
    "detector.noise={kind: quantum}",
    "detector.readout={electronic_noise: 5}",
    "detector.bad_pixels={kind: random, share: 0.02}",
    "detector.correction={flat_frames: 4, dark_frames: 4}",
]
KEEP = "detector.keep=[raw, flat, dark]"


def same_as_rendered_again(store: ScanStore, builder: SimulationBuilder) -> None:
    scan = store.read()
    for view, images in enumerate(machine_frames(scan, builder, range(len(scan)))):
        for name in ("raw", "flat", "dark"):
            np.testing.assert_array_equal(store.frame(name, view), getattr(images, name))
        np.testing.assert_array_equal(store.transmission(view), images.transmission)
        assert scan.bad_pixels is not None
        assert (store.frame("raw", view)[scan.bad_pixels] == 0).all()


def test_they_are_those_that_the_transmission_came_from(
    tiny: Callable[..., Scenario], tmp_path: Path
) -> None:
    builder = SimulationBuilder(tiny(*KEYS, KEEP))
    store = acquire_to_store(builder, tmp_path / "scan.zarr", local_rig, resume=False)
    same_as_rendered_again(store, builder)
    assert verify(store.path).problems == ()
    (store.path / "flat" / "c.1.0.0").write_bytes(b"changed")
    assert "view 1, flat: changed" in verify(store.path).problems[0]
    mended = acquire_to_store(builder, store.path, local_rig, resume=True)
    same_as_rendered_again(mended, builder)


@pytest.mark.process
@pytest.mark.tutorial
def test_over_ros_too(tiny: Callable[..., Scenario], tmp_path: Path) -> None:
    from twinct.link import ros_rigs

    builder = SimulationBuilder(tiny(*KEYS, KEEP))
    store = acquire_to_store(builder, tmp_path / "scan.zarr", ros_rigs(), resume=False)
    same_as_rendered_again(store, builder)


def test_none_are_kept_unasked(tiny: Callable[..., Scenario], tmp_path: Path) -> None:
    scenario = tiny(*KEYS[:2], "detector.readout={}", "detector.keep=[raw]")
    store = acquire_to_store(SimulationBuilder(scenario), tmp_path / "s", local_rig, resume=False)
    assert store.stored_frames == ("raw",)
    with pytest.raises(InputError, match=r"keeps raw and no 'dark' images; .* detector\.keep"):
        store.frame("dark", 0)
    with pytest.raises(InputError, match=r"detector\.keep: an ideal source and detector"):
        tiny("detector.keep=[raw]")
