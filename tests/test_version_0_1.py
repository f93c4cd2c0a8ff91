"""Scans of version 0.1 are read, reported, reconstructed and exported, and mean what they did."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from twinct import load_scan, reconstruct
from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.recon.volume import Volume
from twinct.runs import reconstruct_run, rewrite_report
from twinct.scan import Simulated
from twinct.scenario import load_scenario

KEPT = Path(__file__).parent / "version_0_1"
DEMO = Path(__file__).parents[1] / "scenarios" / "demo.yaml"

ALIKE = 1e-5
"""Of the largest voxel: other versions of the libraries round otherwise."""


@pytest.fixture(params=["local", "ros2"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The run that version 0.1 made over a link."""
    shutil.unpack_archive(KEPT / f"{request.param}.tar.xz", tmp_path)
    return tmp_path


def poses(rows: np.ndarray) -> tuple[Pose, ...]:
    return tuple(Pose(row[:3], row[3:]) for row in rows)


def test_it_is_read_as_it_was_stored(folder: Path) -> None:
    store: Any = zarr.open_group(str(folder / "scan.zarr"), mode="r")
    scan = load_scan(folder)
    np.testing.assert_array_equal(scan.transmission, store["transmission"][:])
    for which in ("commanded", "executed", "believed"):
        for side in ("source", "detector"):
            rows = np.hstack([store[f"{which}/{side}"][:], store[f"{which}/{side}_quat"][:]])
            assert getattr(scan.poses(which), side) == poses(rows)


def test_its_volume_is_what_it_was(folder: Path) -> None:
    then, now = Volume.read(folder / "volume.nii"), reconstruct(load_scan(folder))
    assert np.abs(now.array - then.array).max() <= ALIKE * then.array.max()
    np.testing.assert_allclose(now.grid.affine, then.grid.affine, rtol=1e-6)  # kept to float32


@pytest.mark.process
@pytest.mark.tutorial
@pytest.mark.parametrize("folder", ["ros2", "local"], indirect=True)
def test_it_is_reported_reconstructed_once_more_and_exported(folder: Path) -> None:
    then = json.loads((folder / "metrics.json").read_text())
    assert reconstruct_run(folder, ["reconstruction.algorithm=sirt"]).path.is_dir()
    now = json.loads((folder / "metrics.json").read_text())
    assert now["image"]["rmse_rel"] == pytest.approx(then["image"]["rmse_rel"], rel=1e-4)
    # Two iterations reach 38 % of the contrast: nearer to a constant than to the truth.
    assert now["image"]["signal_rel"] == pytest.approx(0.379, abs=0.001)
    assert (now["image"]["ssim"], now["image"]["mean_reference_rel"]) == (None, None)
    assert now["pose_error"] == then["pose_error"]
    assert (folder / "report.html").read_text().count("Cross-sections of") == 2
    assert run_command(["export", str(folder), "--to", "astra"]) == 0
    assert np.load(folder / "export-astra" / "projections.npy").size == 4 * 18 * 24


def test_a_volume_of_other_settings_is_no_result_of_it(folder: Path) -> None:
    file = folder / "scenario.yaml"
    file.write_text(file.read_text().replace("iterations: 2", "iterations: 3"))
    with pytest.raises(InputError, match="made with settings other than those"):
        rewrite_report(folder)


def test_ten_seeds_of_one_scan_are_ten_scans_of_then() -> None:
    kept, demo = np.load(KEPT / "believed.npz"), load_scenario(DEMO)
    executed = PosePairs(*(poses(rows) for rows in kept["executed"].swapaxes(0, 1)))
    assert len(executed) == 100 and len(kept["believed_mm"]) == 10
    for seed, then in enumerate(kept["believed_mm"]):
        section = demo.uncertainty.model_copy(update={"seed": seed})
        scenario = demo.model_copy(update={"uncertainty": section})
        none, joints = np.zeros(0), kept["joints"]
        scan = Simulated(scenario, executed, executed, (), (), joints, none, none)
        now = scan.reported.poses
        for view, pair in enumerate(then):
            for pose, position, moved in zip(now[view], pair, executed[view], strict=True):
                assert (pose.position == position).all() and (pose.quat == moved.quat).all()
