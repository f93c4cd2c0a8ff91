"""Shards of a study: together they are the study, and nothing else can be merged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.study import Trial, load_results, merge_study, run_study
from twinct.study.shards import Shard

from .conftest import SCENARIO

pytestmark = pytest.mark.process


def study(**more: Any) -> dict[str, Any]:
    """Two scans, of which each has two volumes."""
    axes = [
        {"key": "trajectory.views", "label": "number", "values": [4, 5]},
        {"key": "reconstruction.relaxation", "label": "relaxation", "values": [0.3, 0.6]},
    ]
    return {"scenario": SCENARIO, "axes": axes, "keep": "volume", **more}


def rows(folder: Path) -> pd.DataFrame:
    """All but the times."""
    table = load_results(folder)
    return table.drop(columns=[name for name in table if name.startswith("seconds.")])


@pytest.fixture
def plain_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its pictures take seconds."""
    monkeypatch.setattr(
        "twinct.study.running.write_page", lambda folder, *_: folder.page.write_text("page")
    )


@pytest.mark.usefixtures("plain_page")
def test_shards_make_the_study(tmp_path: Path) -> None:
    whole = run_study(study(), tmp_path / "whole")
    file = tmp_path / "study.yaml"
    file.write_text(json.dumps(study(), default=str))
    parts = [str(tmp_path / f"part{one}") for one in (1, 2)]
    for one, part in enumerate(parts, 1):
        assert run_command(["study", str(file), "--out", part, "--shard", f"{one}/2"]) == 0
    assert [len(load_results(part)) for part in parts] == [2, 2]
    merged = tmp_path / "merged"
    assert run_command(["study", str(file), "--out", str(merged), "--merge", *parts]) == 0
    pd.testing.assert_frame_equal(rows(merged), rows(whole.folder.path))
    kept = sorted(path.name for path in (merged / "trials").rglob("*.nii"))
    assert kept == sorted(path.name for path in (whole.folder.path / "trials").rglob("*.nii"))
    assert merge_study(study(), merged, parts).done == 4  # again changes nothing
    pd.testing.assert_frame_equal(rows(merged), rows(whole.folder.path))


@pytest.mark.usefixtures("plain_page")
def test_missing_trials_are_said_and_mixed_scenarios_refused(tmp_path: Path) -> None:
    part = tmp_path / "part"
    run_study(study(), part, shard="1/2")
    said: list[str] = []
    merged = merge_study(
        study(), tmp_path / "merged", [part], observers=[lambda e: said.append(str(e))]
    )
    assert merged.done == 2
    assert "2 of 4 trials are in no shard" in "".join(said)
    assert run_study(study(), tmp_path / "merged", resume=True).done == 4
    other = study()
    other["axes"][0]["values"] = [6, 7]
    with pytest.raises(InputError, match="2 trials of 2 belong to another study or scenario"):
        merge_study(other, tmp_path / "other", [part])
    assert not (tmp_path / "other").exists()
    with pytest.raises(InputError, match="holds another study"):
        merge_study(study(keep="figures"), tmp_path / "other", [part])
    with pytest.raises(InputError, match="there are no trials of a study to merge"):
        merge_study(study(), tmp_path / "other", [tmp_path / "nowhere"])


def test_trials_that_share_a_scan_are_in_one_shard() -> None:
    trials = [Trial(n, {}, {}, scan=scan) for n, scan in enumerate("abacbda")]
    parts = [Shard(one, 3).part(trials) for one in (1, 2, 3)]
    assert [[one.number for one in part] for part in parts] == [[0, 2, 5, 6], [1, 4], [3]]
    assert sorted(one.number for part in parts for one in part) == list(range(7))


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "1/0", "a/b", "-1/2", "1/2/3"])
def test_a_wrong_shard_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="must be a number from 1, and the number of shards"):
        Shard.parse(text)


def test_more_shards_than_scans_and_shards_of_a_search_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the study has fewer scans than shards"):
        run_study(study(), tmp_path / "part", shard="3/3")
    search = {
        "keys": [{"key": "reconstruction.relaxation", "low": 0.1, "high": 0.9}],
        "figure": "image.rmse_rel",
        "trials": 4,
    }
    with pytest.raises(InputError, match="a search has no shards"):
        run_study({"scenario": SCENARIO, "search": search}, tmp_path / "part", shard="1/2")
    assert not (tmp_path / "part").exists()
