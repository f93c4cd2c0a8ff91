"""Runs of version 1.0 of every kind are read, verified, reported, resumed and reconstructed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from twinct import load_scan, reconstruct, run
from twinct.cli import run_command
from twinct.recon.fast import PASSES, Fast
from twinct.recon.volume import Volume
from twinct.runs import reconstruct_run, rewrite_report
from twinct.runs.folder import read_metrics
from twinct.scenario.version_0_1 import upgraded
from twinct.study import load_results

KEPT = Path(__file__).parent / "version_1_0"

ALIKE = 1e-5
"""Of the largest voxel: other versions of the libraries round otherwise."""

ANEW = 0.3
"""Of the volume's deviation: difference of the volumes of ``fast`` with and without rules."""

SCANS = ["local", "ros2", "gantry", "calibrated", "measured", "recorded"]
WITH_VOLUME = ["local", "ros2", "gantry", "calibrated"]


def kept(name: str, into: Path) -> Path:
    """Unpack a kept run."""
    shutil.unpack_archive(KEPT / f"{name}.tar.xz", into, filter="data")
    return into / name


@pytest.mark.parametrize("name", SCANS)
def test_a_scan_is_read_and_intact(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = kept(name, tmp_path)
    scan = load_scan(folder)
    assert len(scan.transmission) == (24 if name in ("gantry", "measured") else 6)
    assert scan.transmission.min() < 0.9 and scan.transmission.max() > 0.9
    assert run_command(["verify", str(folder)]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", WITH_VOLUME)
def test_its_volume_is_what_it_was(name: str, tmp_path: Path) -> None:
    folder = kept(name, tmp_path)
    then, now = Volume.read(folder / "volume.nii"), reconstruct(load_scan(folder))
    assert np.abs(now.array - then.array).max() <= ALIKE * then.array.max()


@pytest.mark.parametrize("name", WITH_VOLUME)
def test_its_figures_are_what_they_were(name: str, tmp_path: Path) -> None:
    folder = kept(name, tmp_path)
    assert "rmse_bone_rel" in (folder / "metrics.json").read_text()
    then = read_metrics(folder / "metrics.json")
    rewrite_report(folder)
    now = json.loads((folder / "metrics.json").read_text())
    for figure in ("rmse_rel", "rmse_near_rel", "signal_rel"):
        assert now["image"][figure] == pytest.approx(then["image"][figure], rel=1e-4)
    assert "_bone" not in json.dumps([then, now]) and now["reference_material"] == "bone"
    assert (folder / "report.html").is_file()


def test_a_calibrated_geometry_reconstructs_again(tmp_path: Path) -> None:
    folder = kept("calibrated", tmp_path)
    made = reconstruct_run(folder, [], geometry="self")
    assert (made.path / "volume.nii").is_file()


def test_a_measured_scan_is_reconstructed_again(tmp_path: Path) -> None:
    folder = kept("measured", tmp_path)
    then = Volume.read(folder / "reconstructions" / "fast" / "volume.nii")
    assert run_command(["reconstruct", str(folder), "--as", "again"]) == 0
    now = Volume.read(folder / "reconstructions" / "again" / "volume.nii")
    assert now.array.shape == then.array.shape  # by today's fast
    off = np.sqrt(np.mean((now.array - then.array) ** 2))
    assert off < ANEW * then.array.std()


@pytest.mark.process
def test_half_a_scan_is_resumed(tmp_path: Path) -> None:
    folder = kept("half", tmp_path)
    store: Any = zarr.open_array(str(folder / "scan.zarr" / "transmission"), mode="r")
    before = store[:5]
    run(folder / "scenario.yaml", folder, resume=True, link="local")
    after = load_scan(folder).transmission
    assert len(after) == 60 and before.min() < 0.9
    np.testing.assert_array_equal(after[:5], before)


def test_a_study_is_read(tmp_path: Path) -> None:
    table = load_results(kept("study", tmp_path))
    assert len(table) == 4 and table["image.rmse_near_rel"].between(0, 1).all()
    assert not [name for name in table.columns if "bone" in name]


@pytest.mark.parametrize("passes", [None, 3])
def test_keys_that_fast_no_longer_has_are_left_out_of_a_stored_scenario(passes):
    gone = {"coarse_passes": None, "first_relaxation": 1.5, "denoising": None, "stop": None}
    kept = {"algorithm": "fast", "passes": passes, "levels": 2, "margin": 0.1}
    found = upgraded({"reconstruction": gone | kept})["reconstruction"]
    assert Fast.model_validate(found) == Fast(levels=2, margin=0.1, passes=passes or PASSES)
    by_hand = {"reconstruction": kept | {"denoising": 0}}
    assert upgraded(by_hand) is by_hand
