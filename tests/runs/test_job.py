"""A run as a library call: what it gives, and what a resumed one makes of other settings."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pytest
from waiting import HANG_S

from twinct import run
from twinct.core.errors import FolderInUseError, InputError, ScanExistsError
from twinct.core.files.lock import sole_owner
from twinct.observers.events import Said
from twinct.recon.volume import Volume
from twinct.runs import Run, rewrite_report, truth_of
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario

Tiny = Callable[..., Scenario]
DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
OTHERS = {
    "algorithm": ["reconstruction.algorithm=cgls", "reconstruction.iterations=2"],
    "grid": ["reconstruction.grid={voxels: 12, voxel_mm: 14, centre_mm: [3, -5, 7]}"],
}


def test_a_run_gives_scan_volume_figures_and_paths_and_says_nothing(
    tiny: Tiny, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    done = run(tiny(), tmp_path / "out", link="local")
    said = capfd.readouterr()
    assert said.out == said.err == ""
    assert len(done.scan) == done.figures["views"] == 10
    assert np.asarray(done.volume).shape == (20, 20, 20)
    assert done.paths.report.is_file() and not done.paths.lock.exists()


def test_the_truth_lies_beside_the_volume_on_its_grid(finished: Run) -> None:
    truth, volume = Volume.read(finished.paths.truth), finished.volume
    np.testing.assert_array_equal(truth.grid.affine, volume.grid.affine)
    expected = truth_of(finished.scan, SimulationBuilder(finished.scenario))
    np.testing.assert_array_equal(truth.array, expected.volume)
    errors = truth.array[expected.region] - volume.array[expected.region]
    rmse = float(np.sqrt(np.mean(errors.astype(float) ** 2))) / expected.mu_reference
    assert rmse == pytest.approx(finished.figures["image"]["rmse_rel"], rel=1e-6)


@pytest.mark.tutorial
@pytest.mark.usefixtures("unreported")
@pytest.mark.parametrize("key", ["algorithm", "grid"])
def test_resuming_with_other_settings_makes_what_a_fresh_run_makes(
    key: str, tiny: Tiny, finished: Run, tmp_path: Path
) -> None:
    out, other = tmp_path / "out", tiny(*OTHERS[key])
    shutil.copytree(finished.paths.path, out)
    heard: list[Said] = []
    again = run(other, out, link="local", resume=True, observers=[heard.append])
    said = [event.text for event in heard if isinstance(event, Said)]
    assert any("volume.nii is replaced: it was made with other settings" in one for one in said)
    fresh = run(other, tmp_path / "fresh", link="local")
    volumes = [nibabel.loadsave.load(r.paths.volume) for r in (again, fresh)]
    np.testing.assert_array_equal(*(np.asarray(v.dataobj) for v in volumes))
    np.testing.assert_array_equal(*(v.affine for v in volumes))
    np.testing.assert_array_equal(volumes[0].affine, other.reconstruction.grid.volume_grid.affine)
    for name in ("image", "reconstruction_digest", "residuals"):
        assert again.figures[name] == fresh.figures[name]


def test_a_volume_of_other_settings_is_not_reported(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.paths.path, tmp_path / "out")
    file = tmp_path / "out" / finished.paths.scenario.name
    file.write_text(file.read_text().replace("relaxation: 0.3", "relaxation: 0.4"))
    with pytest.raises(InputError, match="made with settings other than those"):
        rewrite_report(tmp_path / "out")


def test_another_process_in_the_folder_is_named(tiny: Tiny, finished: Run) -> None:
    before = {p: p.stat().st_mtime_ns for p in finished.paths.path.rglob("*") if p.is_file()}
    other = tiny("reconstruction.iterations=1")
    with sole_owner(finished.paths.lock):
        for work in (
            lambda: run(other, finished.paths.path, link="local", resume=True),
            lambda: rewrite_report(finished.paths.path),
        ):
            with pytest.raises(FolderInUseError, match=f"process {os.getpid()} on "):
                work()
    after = {p: p.stat().st_mtime_ns for p in finished.paths.path.rglob("*") if p.is_file()}
    assert after == before
    with pytest.raises(ScanExistsError):
        run(other, finished.paths.path, link="local")


@pytest.mark.tutorial
@pytest.mark.process
def test_two_runs_at_once_leave_one_good_scan(tiny_keys: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    keys = [word for key in tiny_keys for word in ("--set", key)]
    with contextlib.ExitStack() as stack:
        both: list[subprocess.Popen[str]] = []
        for _ in range(2):
            process = subprocess.Popen(
                [sys.executable, "-m", "twinct", "run", str(DEMO), "--link", "local", *keys]
                + ["--out", str(out)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            both.append(process)
        said = [process.communicate(timeout=HANG_S)[1] for process in both]
    codes = [process.returncode for process in both]
    assert sorted(codes) == [0, 2], said
    refused = said[codes.index(2)]
    assert "is using this folder" in refused or "already holds" in refused
    assert "Traceback" not in refused and "bug" not in refused
    assert json.loads((out / "metrics.json").read_text())["reached"] == 10
