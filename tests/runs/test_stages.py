"""A run makes the stages that are due, and no others."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from twinct.runs import Run, run
from twinct.runs.stages import Stage, due, make_due
from twinct.scenario import Scenario

REGION = "evaluation={regions: [{name: middle, shape: {kind: sphere, radius_mm: 30}}]}"


@pytest.fixture
def folder(finished: Run, tmp_path: Path) -> Path:
    """A copy of the finished run."""
    return Path(shutil.copytree(finished.paths.path, tmp_path / "out"))


def test_stages_that_are_due_are_made_in_their_order(tmp_path: Path) -> None:
    made_from, made = {"a": "1", "b": "0", "c": "2"}, []
    stages = [
        Stage(name, digest, (tmp_path / name,), lambda name=name: made_from[name])
        for name, digest in (("a", "1"), ("b", "1"), ("c", "2"))
    ]
    for name in "ab":
        (tmp_path / name).touch()
    assert due(stages) == ["b", "c"]

    def both() -> None:
        made.append("b")
        (tmp_path / "c").touch()

    make_due(stages, {"b": both, "c": lambda: made.append("c")})
    assert made == ["b"]


@pytest.mark.usefixtures("unreported")
@pytest.mark.parametrize("lost", ["report.html", "truth.nii"])
def test_a_lost_page_or_truth_costs_no_volume(
    lost: str, folder: Path, finished: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.runs.job.reconstruct", lambda *_, **__: 1 / 0)
    (folder / lost).unlink()
    again = run(finished.scenario, folder, link="local", resume=True)
    assert (folder / lost).is_file()
    assert again.figures["image"] == finished.figures["image"]


@pytest.mark.usefixtures("unreported")
def test_a_damaged_view_hides_no_other_figures(
    folder: Path, finished: Run, tiny: Callable[..., Scenario], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.runs.job.reconstruct", lambda *_, **__: 1 / 0)
    (folder / "scan.zarr" / "status" / "c.9").unlink()
    run(tiny(REGION), folder, link="local", resume=True)
    told = json.loads((folder / "metrics.json").read_text())
    assert 0.5 < told["image"]["regions"]["middle"]["mean_rel"] < 1.5
    assert told["image"]["rmse_rel"] == finished.figures["image"]["rmse_rel"]
