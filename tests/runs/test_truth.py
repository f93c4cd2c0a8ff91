"""Truth, specimen and masks: computed once, kept by the process, and read from a run's folder."""

from __future__ import annotations

import math
import mmap
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinct import run
from twinct.core.cached import forget, once
from twinct.recon.volume import Volume
from twinct.runs import Run, judge, reconstruct_run, rewrite_report, truth, truth_of
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario
from twinct.specimen import BuiltSpecimen

COUNTED = {
    "specimen": "twinct.scan.builder.build_specimen",
    "region": "twinct.runs.truth.region_of_interest",
    "edges": "twinct.runs.truth.edges_of",
    "near": "twinct.evaluation.image.near",
    "windows": "twinct.evaluation.image.whole_windows",
}


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each of the long computations was called, from nothing kept on."""
    found: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def count(*arguments: Any) -> Any:
            found[name] += 1
            return function(*arguments)

        return count

    for name, path in COUNTED.items():
        module, attribute = path.rsplit(".", 1)
        real = getattr(__import__(module, fromlist=[attribute]), attribute)
        monkeypatch.setattr(path, counted(name, real))
    monkeypatch.setattr(BuiltSpecimen, "truth", counted("truth", BuiltSpecimen.truth))
    for kind in ("truth", "specimen"):
        forget(kind)
    return found


@pytest.mark.usefixtures("unreported")
def test_further_volumes_share_everything(
    tiny: Callable[..., Scenario], tmp_path: Path, calls: Counter[str]
) -> None:
    once_each = {name: 1 for name in (*COUNTED, "truth")}
    scenario = tiny("cell={kind: gantry}", "reconstruction.geometry=[believed, executed]")
    made = run(scenario, tmp_path / "out", link="local")
    assert calls == once_each
    reconstruct_run(tmp_path / "out", ["reconstruction.iterations=3"])
    assert calls == once_each
    before = made.figures["image"]
    forget("truth")  # as in another process
    again = rewrite_report(tmp_path / "out").figures["image"]
    assert again == before
    assert calls == {**dict.fromkeys(once_each, 2), "truth": 1, "specimen": 1}


@pytest.mark.usefixtures("unreported")
def test_a_file_that_holds_another_truth_is_replaced(
    tiny: Callable[..., Scenario], tmp_path: Path, calls: Counter[str]
) -> None:
    made = run(tiny("cell={kind: gantry}"), tmp_path / "out", link="local")
    file, before = made.paths.truth, made.figures["image"]
    right = Volume.read(file).array.copy(), Volume.read(file).grid
    for damage in (
        lambda: Volume(right[0] * 2, right[1]).write(file, "twinct truth, 1/mm"),
        lambda: file.write_bytes(b"cut off"),
        file.unlink,
    ):
        damage()
        forget("truth")
        assert rewrite_report(tmp_path / "out").figures["image"] == before
        np.testing.assert_array_equal(Volume.read(file), right[0])
    assert calls["truth"] == 4


def test_a_large_truth_takes_no_memory_beside_other_work(
    finished: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = truth_of(finished.scan, SimulationBuilder(finished.scenario))
    voxels, file = math.prod(held.grid.shape), finished.paths.truth
    assert held.written(file) is held and truth.held_bytes(held.grid) == 5 * voxels
    monkeypatch.setattr(truth, "_MOST_KEPT", 0)
    mapped = held.written(file)
    assert truth.held_bytes(held.grid) == voxels
    below: Any = mapped.volume
    while isinstance(below, np.ndarray):
        below = below.base
    assert isinstance(below, mmap.mmap)
    figures = (judge(finished.scan, finished.volume, one).as_dict() for one in (held, mapped))
    assert next(figures) == next(figures)


def test_only_the_last_of_a_kind_is_kept() -> None:
    made: list[str] = []

    def make(name: str) -> Callable[[], str]:
        return lambda: made.append(name) or name

    for name in ("a", "a", "b", "a"):
        assert once("letters of a test", name, make(name)) == name
    assert made == ["a", "b", "a"]
    forget("letters of a test")
