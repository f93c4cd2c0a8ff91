"""Scans in sweeps that end once twice as many views hardly change the volume."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinct import needs, run, simulate, verify
from twinct.core.errors import DamagedError, InputError, ScenarioError
from twinct.evaluation.region_voxels import whole
from twinct.observers.events import Said
from twinct.runs.early_end import relative_change
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scan.status import status_file
from twinct.scan.sweeps import SWEEPS
from twinct.scenario import Scenario
from twinct.trajectory import ends_of_sweeps, farthest_first, in_sweeps

Tiny = Callable[..., Scenario]
KEYS = ["trajectory.views=40", "until.first=8", "cell={kind: gantry}"]
ALWAYS, NEVER = "until.change_rel=0.9", "until.change_rel=1e-9"

pytestmark = pytest.mark.usefixtures("unreported")


def test_sweeps_double_the_views_every_second_time() -> None:
    assert ends_of_sweeps(400, 24) == (24, 34, 48, 68, 96, 136, 192, 272, 384, 400)
    assert ends_of_sweeps(48, 24) == (24, 34, 48)
    assert ends_of_sweeps(24, 24) == ends_of_sweeps(24, 30) == (24,)


def test_every_sweep_leaves_the_views_evenly_spread(tiny: Tiny) -> None:
    """No gap is more than twice the smallest: the bound of the farthest-first rule."""
    views = SimulationBuilder(tiny("trajectory={kind: circle, views: 360}")).requested
    order = in_sweeps(views, 24)
    assert sorted(order) == list(range(360))
    for end in ends_of_sweeps(360, 24):
        gaps = np.diff([*sorted(order[:end]), 360 + min(order[:end])])
        assert gaps.max() <= 2 * gaps.min() + 1


def test_a_sweep_follows_the_path_and_the_next_one_returns(tiny: Tiny) -> None:
    views = SimulationBuilder(tiny("trajectory={kind: arc, views: 60}")).requested
    order, ends = in_sweeps(views, 8), (0, *ends_of_sweeps(60, 8))
    for sweep, (begin, end) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        steps = np.diff(order[begin:end])
        assert (steps < 0).all() if sweep % 2 else (steps > 0).all()


def test_points_at_one_place_are_taken_once_each() -> None:
    assert sorted(farthest_first(np.zeros((5, 3)), 5)) == [0, 1, 2, 3, 4]


def test_the_scan_ends_with_the_first_sweep_that_changes_little(tiny: Tiny, tmp_path: Path) -> None:
    said: list[str] = []

    def hear(event: object) -> None:
        if isinstance(event, Said):
            said.append(event.text)

    made = run(tiny(*KEYS, ALWAYS), tmp_path / "out", link="local", observers=[hear])
    assert len(made.scan) == made.figures["views"] == made.figures["reached"] == 16
    assert made.figures["planned_views"] == 40
    assert list(made.figures["changes_rel"]) == ["16"]
    assert any("16 views change the volume of 8 views" in text for text in said)
    assert verify(tmp_path / "out").problems == ()


def test_the_change_is_that_of_the_two_volumes(tiny: Tiny, tmp_path: Path) -> None:
    from twinct import reconstruct

    scenario = tiny(*KEYS, ALWAYS)
    scan = run(scenario, tmp_path / "out", link="local").scan
    half, all_ = (reconstruct(scan.of_views(range(n))).array.astype(float) for n in (8, 16))
    noted = ScanStore(tmp_path / "out" / "scan.zarr").sweeps.changes_rel[16]
    assert noted == pytest.approx(np.linalg.norm(all_ - half) / np.linalg.norm(all_), rel=1e-5)


def test_only_the_region_of_the_task_counts() -> None:
    before = np.ones((4, 4, 4), np.float32)
    after = before.copy()
    after[0] = 3
    region = np.zeros(before.shape, np.bool_)
    region[2:] = True
    assert relative_change(before, after, whole(region)) == 0
    assert relative_change(before, after, whole(~region)) > 0.5
    assert relative_change(0 * before, 0 * before, whole(region)) == 1


def test_a_scan_that_keeps_changing_takes_all_views(tiny: Tiny, tmp_path: Path) -> None:
    made = run(tiny(*KEYS, NEVER), tmp_path / "out", link="local")
    assert len(made.scan) == 40
    assert [int(views) for views in made.figures["changes_rel"]] == [16, 22, 32]


def test_the_first_views_are_those_of_the_whole_scan(tiny: Tiny) -> None:
    """The end leaves images and poses alone."""
    short, long = (simulate(tiny(*KEYS, key)) for key in (ALWAYS, NEVER))
    np.testing.assert_array_equal(short.transmission, long.transmission[:16])
    assert len(short.believed) == len(short.commanded) == 16


def test_each_view_keeps_its_tube_load(tiny: Tiny, tmp_path: Path) -> None:
    plain = SimulationBuilder(tiny("trajectory.views=12"))
    views, mas = plain.requested, np.arange(12.0) + 1
    rows = np.column_stack([views.source, views.detector, views.u, views.v, mas])
    path = tmp_path / "views.csv"
    np.savetxt(path, rows, delimiter=",", header="all", comments="#")
    section = f"trajectory={{kind: file, path: {path}}}"
    builder = SimulationBuilder(tiny(section, "until.first=4", "cell={kind: gantry}"))
    order = in_sweeps(views, 4)
    assert builder.mas is not None
    np.testing.assert_array_equal(builder.mas, mas[order])
    np.testing.assert_allclose(builder.requested.source, views.source[order])


@pytest.mark.parametrize("views", [5, 16, 19])
def test_a_resumed_scan_ends_as_an_undisturbed_one(
    tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, views: int
) -> None:
    scenario = tiny(*KEYS, "until.change_rel=0.02")
    whole_run = run(scenario, tmp_path / "whole", link="local")

    written = ScanStore.write

    def killed(self: ScanStore, index: int, *view: Any) -> None:
        if index == views:
            raise KeyboardInterrupt
        written(self, index, *view)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(ScanStore, "write", killed)
        run(scenario, tmp_path / "out", link="local")
    resumed = run(scenario, tmp_path / "out", link="local", resume=True)
    stores = [ScanStore(one.paths.scan) for one in (whole_run, resumed)]
    assert (stores[0].path / SWEEPS).read_bytes() == (stores[1].path / SWEEPS).read_bytes()
    np.testing.assert_array_equal(resumed.volume.array, whole_run.volume.array)


def test_a_changed_end_is_damage_and_a_resumed_scan_finds_it_again(
    tiny: Tiny, tmp_path: Path
) -> None:
    scenario = tiny(*KEYS, ALWAYS)
    made = run(scenario, tmp_path / "out", link="local")
    record = made.paths.scan / SWEEPS
    intact = record.read_bytes()
    data = json.loads(intact)
    record.write_text(json.dumps(data | {"complete": 12}))
    with pytest.raises(DamagedError, match=r"status/sweeps\.json: changed"):
        ScanStore(made.paths.scan).read()
    assert any("sweeps.json" in problem for problem in verify(tmp_path / "out").problems)
    run(scenario, tmp_path / "out", link="local", resume=True)
    assert record.read_bytes() == intact


def test_a_view_lost_at_the_end_of_a_sweep_is_taken_again(tiny: Tiny, tmp_path: Path) -> None:
    """Its sweep is not compared anew, as the scan has a gap there."""
    scenario = tiny(*KEYS, NEVER)
    made = run(scenario, tmp_path / "out", link="local")
    (made.paths.scan / SWEEPS).unlink()
    (made.paths.scan / status_file(16)).unlink()
    again = run(scenario, tmp_path / "out", link="local", resume=True)
    np.testing.assert_array_equal(again.scan.transmission, made.scan.transmission)


def test_other_criteria_are_other_scans(tiny: Tiny, tmp_path: Path) -> None:
    run(tiny(*KEYS, ALWAYS), tmp_path / "out", link="local")
    with pytest.raises(InputError, match="another scenario"):
        run(tiny(*KEYS, NEVER), tmp_path / "out", link="local", resume=True)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (["motion.order=shortest"], "motion.order: shortest contradicts until"),
        (["until.change_rel=0"], "above 0 and below 1"),
        (["until.change_rel=1"], "above 0 and below 1"),
        (["until.first=3"], "greater than or equal to 4"),
    ],
)
def test_refused(tiny: Tiny, keys: list[str], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        tiny("until.first=8", *keys)


@pytest.mark.process
def test_over_ros_the_scan_ends_with_the_same_views(tiny_keys: list[str], tmp_path: Path) -> None:
    keys = [*tiny_keys, *KEYS[:2], ALWAYS]
    records: list[bytes] = []
    for link in ("ros2", "local"):
        out = tmp_path / link
        command = [sys.executable, "-m", "twinct", "run", "demo", "--out", str(out), "--link", link]
        done = subprocess.run(
            [*command, *(part for key in keys for part in ("--set", key))],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        assert "16 views change the volume of 8 views" in done.stderr + done.stdout
        records.append((out / "scan.zarr" / SWEEPS).read_bytes())
    assert records[0] == records[1]


def test_the_volumes_between_sweeps_count_in_the_needs(tiny: Tiny) -> None:
    plain, swept = (needs(tiny("trajectory.views=40", *more)) for more in ((), KEYS[1:2]))
    assert swept["views"].memory_bytes > plain["views"].memory_bytes
    assert swept["reconstruction"] == plain["reconstruction"]
