"""Runs compared: what they hold is read as it is, and what holds none is refused before work."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from twinct import compare
from twinct.core.errors import InputError
from twinct.report import cross_sections
from twinct.runs import Run, reconstruct_run

GRID = "{voxels: 12, voxel_mm: 12}"


@pytest.fixture(scope="module")
def folder(finished: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a further reconstruction beside its own."""
    out = shutil.copytree(finished.paths.path, tmp_path_factory.mktemp("compare") / "a" / "out")
    keys = ["reconstruction.algorithm=cgls", f"reconstruction.grid={GRID}"]
    with pytest.MonkeyPatch.context() as patch:  # its report is not needed
        patch.setattr("twinct.runs.reconstruction.rewrite_report", lambda *_: None)
        reconstruct_run(out, keys, geometry="executed", name="other")
    return out


def test_a_run_and_what_was_reconstructed_beside_it(folder: Path, finished: Run) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    found = compare([folder, folder / "reconstructions" / "other"])
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    first, other = found.compared
    assert (first.label, other.label) == ("out", "out:other")
    assert first.metrics == other.metrics == finished.figures
    told = json.loads((folder / "reconstructions" / "other" / "reconstruction.json").read_text())
    assert other.image == told["figures"]
    assert other.seconds == {"reconstruction": told["seconds"]}
    assert found.keys["reconstruction.algorithm"] == ("sart", "cgls")
    assert found.keys["reconstruction.geometry"] == ("believed", "executed")
    assert all(key.startswith("reconstruction.") for key in found.keys)
    assert found.notes == [
        "out:other and out have different grids: each is judged in its own voxels."
    ]

    grid = finished.scenario.reconstruction.grid.volume_grid
    volume = finished.volume.array
    wanted = cross_sections(volume, np.ones_like(volume), np.ones(grid.shape, bool), grid)
    for name, section in first.slices.items():
        assert section is not None
        np.testing.assert_array_equal(section.reconstruction, wanted[name].reconstruction)
        assert section.position == wanted[name].position
        seen = other.slices[name]
        assert seen is not None and seen.reconstruction.shape == (12, 12)
        assert section.truth.max() == pytest.approx(first.mu_reference, rel=1e-5)
        assert 0 < section.roi.mean() < 1


def test_two_runs_are_named_by_what_tells_them_apart(
    folder: Path, finished: Run, tmp_path: Path
) -> None:
    second = shutil.copytree(folder, tmp_path / "b" / "out")
    shutil.copytree(folder, tmp_path / "c" / "out")
    file = second / "scenario.yaml"
    file.write_text(file.read_text().replace("material: bone", "material: water"))
    # As if its volume had been made so: that is not this test's matter.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twinct.runs.job._note_of", lambda *_: finished.volume.extras["note"])
        found = compare([tmp_path / "c" / "out", second])
    assert [one.label for one in found.compared] == ["c/out", "b/out"]
    assert found.keys == {"specimen.parts.0.material": ("bone", "water")}
    assert "b/out and c/out show different specimens" in found.notes[0]


def test_what_cannot_be_compared_is_named_before_any_work(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.scan.builder.build_specimen", lambda _: pytest.fail("work"))
    link = tmp_path / "link"
    link.symlink_to(folder)
    empty = tmp_path / "empty"
    with pytest.raises(InputError) as refused:
        compare([folder, link, empty, folder / "reconstructions" / "none"])
    twice, no_run, none = refused.value.problems
    assert twice == f"{link}: given twice; each folder is compared once"
    assert no_run.startswith(f"{empty} holds no finished run: scan.zarr, volume.nii")
    assert none.startswith(f"{folder}/reconstructions/none is not a reconstruction of a run")
    with pytest.raises(InputError, match="^1 folder: at least two") as refused:
        compare([folder])
    assert str(refused.value).endswith(f"its reconstructions are {folder}/reconstructions/other")
    with pytest.raises(InputError, match="^0 folders: at least two are needed$"):
        compare([])


def test_damage_is_named(folder: Path, tmp_path: Path) -> None:
    out = shutil.copytree(folder, tmp_path / "out")
    volume = out / "reconstructions" / "other" / "volume.nii"
    volume.write_bytes(volume.read_bytes()[:-1] + b"?")
    (out / "metrics.json").write_text("{")
    with pytest.raises(InputError) as refused:
        compare([out, out / "reconstructions" / "other"])
    assert "cannot read the figures" in refused.value.problems[0]
    assert "differs from the file written for other" in refused.value.problems[1]
