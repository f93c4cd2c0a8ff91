"""A scan in memory is saved as the store that a run writes, byte by byte, or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import twinct
from twinct.core.errors import InputError, ScanExistsError, StorageError
from twinct.geometry.wire import PosePairs
from twinct.runs import Run, export_scan, verify
from twinct.scan import Scan, ScanStore, Simulated
from twinct.scan.named_geometries import poses_digest
from twinct.scenario import Scenario, load_scenario

GANTRY = Path(__file__).parents[2] / "scenarios" / "circle_gantry.yaml"


@pytest.fixture(scope="module")
def scan() -> Scan:
    """Of a mesh, with motion blur, lag, bad pixels and tube loads: all that a view can carry."""
    keys = {
        "xray.engine": "mesh",
        "detector": {"columns": 16, "rows": 12, "pixel_pitch_mm": 20, "lag": 0.1},
        "detector.bad_pixels": {"kind": "random", "share": 0.05},
        "source.motion_samples": 2,
        "source.exposure_ms": 900,
        "reconstruction": {"grid": {"voxels": 10, "voxel_mm": 16}, "iterations": 1},
    }
    around = np.linspace(0.0, 1.5, 4)
    out = 300 * np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    mine = {"specimen": trimesh.creation.box((60, 50, 40)), "trajectory": (out, -out, around + 1)}
    return twinct.simulate(load_scenario(GANTRY, {**keys, **mine}))


def contents(folder: Path) -> dict[Path, bytes]:
    files = (file for file in folder.rglob("*") if file.is_file())
    return {file.relative_to(folder): file.read_bytes() for file in files}


def test_a_saved_scan_is_loaded_again(scan: Scan, tmp_path: Path) -> None:
    path = tmp_path / "mine" / "scan.zarr"
    scan.save(str(path))
    again = twinct.load_scan(path)
    of_scan = {field.name for field in fields(Scan)} - {"provenance"}
    of_machine = {field.name for field in fields(Simulated)} - {"scenario", "acquired"}
    for name in of_scan | of_machine:
        one, other = (scan, again) if name in of_scan else (scan.simulated, again.simulated)
        mine, its = getattr(one, name), getattr(other, name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(its, mine)
            assert its.dtype == mine.dtype
        elif isinstance(mine, PosePairs):
            assert poses_digest(its) == poses_digest(mine), name
        else:
            assert its == mine, name
    assert again.reported.digest == scan.reported.digest
    np.testing.assert_array_equal(twinct.reconstruct(again), twinct.reconstruct(scan))
    assert twinct.evaluate(again, twinct.reconstruct(again)).rmse_rel > 0
    assert not verify(path).problems and not verify(path.parent).problems
    export_scan(
        path, "astra", geometry="executed", values="line-integrals", out=tmp_path / "export"
    )


@pytest.mark.usefixtures("unreported")
def test_it_is_what_a_run_stores_and_a_run_goes_on_from_it(scan: Scan, tmp_path: Path) -> None:
    scan.save(tmp_path / "mine" / "scan.zarr")
    made = twinct.run(scan.scenario, tmp_path / "mine", link="local", resume=True)
    np.testing.assert_array_equal(made.scan.transmission, scan.transmission)
    stored = contents(tmp_path / "mine" / "scan.zarr")
    (tmp_path / "mine").rename(tmp_path / "before")  # a store names its files beside it
    twinct.run(scan.scenario, tmp_path / "mine", link="local")
    assert contents(tmp_path / "mine" / "scan.zarr") == stored


def test_arms_keep_their_plan(tiny: Callable[..., Scenario], finished: Run, tmp_path: Path) -> None:
    twinct.simulate(tiny()).save(tmp_path / "scan.zarr")
    assert contents(tmp_path / "scan.zarr") == contents(finished.paths.scan)


def test_nothing_is_overwritten_or_left_half(
    scan: Scan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "scan.zarr"
    written = ScanStore.write

    def full(store: ScanStore, index: int, *rest: object) -> None:
        if index == 2:
            raise OSError(28, "No space left on device")
        written(store, index, *rest)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(ScanStore, "write", full)
        with pytest.raises(StorageError, match="disk is full"):
            scan.save(path)
    assert {file.name for file in tmp_path.iterdir()} == {"inputs"}
    (tmp_path / "scan.zarr.new").mkdir()
    (tmp_path / "scan.zarr.new" / "zarr.json").write_text("of somebody else")
    scan.save(path)
    assert (tmp_path / "scan.zarr.new" / "zarr.json").read_text() == "of somebody else"
    before = contents(tmp_path)
    with pytest.raises(ScanExistsError, match=r"scan\.zarr exists already"):
        scan.save(path)
    assert contents(tmp_path) == before


def test_changed_images_are_no_scenarios_images(scan: Scan, tmp_path: Path) -> None:
    smooth = replace(scan, transmission=np.sqrt(scan.transmission))
    smooth.save(tmp_path / "scan.zarr")
    again = twinct.load_scan(tmp_path / "scan.zarr")
    np.testing.assert_array_equal(again.transmission, smooth.transmission)
    assert not verify(tmp_path / "scan.zarr").problems
    with pytest.raises(ScanExistsError, match="digest of images: changed there"):
        twinct.run(scan.scenario, tmp_path, link="local", resume=True)


def test_what_a_store_needs_is_not_made_up(scan: Scan, tmp_path: Path) -> None:
    path = tmp_path / "scan.zarr"
    scan.save(tmp_path / "one.zarr")
    elsewhere = replace(scan.simulated, executed=scan.commanded)
    for wrong, why in (
        (twinct.load_scan(tmp_path / "one.zarr"), r"not from simulate\(\)"),
        (replace(scan, provenance=elsewhere), "not those of the acquisition"),
        (scan.with_settings(scan.scenario.with_({"detector.keep": ["raw"]})), "detector.keep"),
    ):
        with pytest.raises(InputError, match=why):
            wrong.save(path)
    assert not path.exists()
