"""A study's folder that a stranger made: nothing in it runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from planted import planted, unpickled

from twinct.core import cached
from twinct.scenario import parse_scenario, specimen_digest, stage_digests
from twinct.study import trial
from twinct.study.trial import TrialSpec, try_trial
from twinct.version import __version__
from twinct.workers import Place

from .conftest import SCENARIO

ARMS: dict[str, Any] = {
    **SCENARIO,
    "cell": {"kind": "arms"},
    "trajectory": {"kind": "sinusoid", "views": 3, "longitude_range_deg": 10},
}


@pytest.fixture(autouse=True)
def _afresh(monkeypatch: pytest.MonkeyPatch) -> None:
    """No engine is loaded beforehand, and nothing is kept in this process."""
    monkeypatch.setattr(trial, "_started", True)
    monkeypatch.setattr(cached, "_last", {})


def tried(scenario: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The figures of a trial in this process, with nothing of an earlier one in it."""
    cached._last.clear()
    spec = TrialSpec("key", scenario, {}, "scan", shared=False, keep="figures", link="local")
    return try_trial(spec, Place(folder, 1, {}.__getitem__))["figures"]


def test_a_worker_loads_no_pickle_of_its_folder(tmp_path: Path) -> None:
    work, mark = tmp_path / "work", tmp_path / "mark"
    parsed = parse_scenario(json.loads(json.dumps(ARMS)))
    digests = {specimen_digest(parsed), stage_digests(parsed)["executed"]}
    (work / "things").mkdir(parents=True)
    for digest in digests:  # where earlier versions looked for them
        (work / "things" / f"{digest}-{__version__}").write_bytes(planted(mark))
    with unpickled() as found:
        first = tried(ARMS, work)
        files = [path for path in work.rglob("*") if path.is_file() and path.name[0] != "."]
        kinds = {path.relative_to(work).parts[0] for path in files}
        assert kinds >= {"specimens", "plans", "arrays"}
        for path in files:
            path.write_bytes(planted(mark))
        assert tried(ARMS, work) == first  # made again
        assert tried(ARMS, work) == first  # read
    assert not found and not mark.exists()
