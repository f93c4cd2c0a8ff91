"""One small scan, taken and recorded once."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from twinct.link.recording import recorder_of
from twinct.runs import acquire_to_store
from twinct.scan import LocalRig, SimulationBuilder
from twinct.scenario import load_scenario

SCENARIO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
SHORT = (
    *("trajectory.views=4", "trajectory.longitude_range_deg=20"),
    *("trajectory.latitude_amplitude_deg=5", "detector.columns=32", "detector.rows=24"),
    *("detector.pixel_pitch_mm=10", "source.motion_samples=2", "source.exposure_ms=8"),
    "specimen.parts=[{name: ball, material: bone, "
    "shape: {kind: sphere, radius_mm: 60, mesh_resolution_mm: 4}}]",
)


class TinyImager:
    """An image that depends on every bit of the geometry."""

    def expose(self, path, view=0, before=None, *, time_s=0.0):
        del before
        seed = np.abs(path.source[-1].position.view(np.int64)).tolist()
        noise = np.random.default_rng([view, *seed])
        return noise.random((24, 32), dtype=np.float32)

    def close(self):
        pass


class Taken(NamedTuple):
    """A folder with ``scan.zarr`` and ``scan.mcap``, and what it was made with."""

    folder: Path
    builder: SimulationBuilder


@pytest.fixture(scope="session")
def take() -> Callable[..., Taken]:
    """Takes a scan with real arms, or a gantry, and tiny images, and records it."""

    @cache
    def planned(keys: tuple[str, ...]) -> SimulationBuilder:
        return SimulationBuilder(load_scenario(SCENARIO, [*SHORT, *keys]))

    def take(folder: Path, *keys: str) -> Taken:
        builder = planned(keys)

        def make_rig(builder, first, state):
            robots = builder.robots()
            if state is not None:
                robots.restore(state)
            return LocalRig(robots, TinyImager(), builder.scenario.detector.panel)

        recording = recorder_of("local", folder)
        folder.mkdir(parents=True, exist_ok=True)
        rigs = recording.rigs(make_rig)
        try:
            store = acquire_to_store(builder, folder / "scan.zarr", rigs, resume=True)
            recording.finish(store.reported)
        finally:
            recording.close()
        return Taken(folder, builder)

    return take


@pytest.fixture(scope="session")
def taken(take, tmp_path_factory) -> Taken:
    """Four views of two arms."""
    return take(tmp_path_factory.mktemp("taken"))
