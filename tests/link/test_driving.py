"""A plan that goes to controllers: names, limits, start, refusals, aborts, silence."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("mcap")

from mcap.reader import make_reader
from stand_in import StandIn
from waiting import HANG_S, until

from twinct.cli import run_command
from twinct.cli.commands.drive import drive
from twinct.core.errors import InputError, StorageError
from twinct.link.driving import QUIET_S, Drive, DriveSettings, names_of
from twinct.link.follow import ControllerError, courses
from twinct.link.participant import Station
from twinct.link.recording.bag import Bag
from twinct.link.recording.drive_file import DriveFile
from twinct.link.stamps import Stamp
from twinct.robots.motion import Gate, MotionPlan, gate_of
from twinct.robots.programs import Program, program_of
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario

pytestmark = pytest.mark.process

SCENARIO = {
    "trajectory": {"kind": "arc", "views": 4, "longitude_range_deg": 4},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}]
    },
    "detector": {"columns": 16, "rows": 12, "pixel_pitch_mm": 20},
}
ACTIONS = ("/left/follow_joint_trajectory", "/right/follow_joint_trajectory")
LIMITS = '<robot name="r">{}</robot>'
LIMIT = '<joint name="{}" type="revolute"><limit lower="-7" upper="7" velocity="{}"/></joint>'


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(SCENARIO)


@pytest.fixture(scope="module")
def plan(scenario: Scenario) -> MotionPlan:
    plan = SimulationBuilder(scenario).plan
    assert plan is not None
    return plan


@pytest.fixture(scope="module")
def program(plan: MotionPlan) -> Program:
    return program_of(plan, "a test", ("left_", "right_"))


@pytest.fixture
def arms(domain: int, program: Program) -> Iterator[Callable[..., StandIn]]:
    """Maker of the driver of an arm."""
    made: list[StandIn] = []

    def make(arm: int, **choices: Any) -> StandIn:
        home = program.states(arm)[0, 0]
        choices = {"home": home, "joints": program.names[arm], "action": ACTIONS[arm]} | choices
        made.append(StandIn(domain, **choices, seed=arm + 1))
        return made[-1]

    yield make
    for arm in made:
        arm.close()


class Run:
    """One drive, its file and its error."""

    def __init__(self, domain: int, scenario: Scenario, program: Program, folder: Path) -> None:
        self.station, self.path = Station("twinct_drive", domain), folder / "drive.mcap"
        self._scenario, self._program = scenario, program
        self.gate = gate_of(SimulationBuilder(scenario).cell, scenario.motion)

    def drive_of(
        self, *, speed: float = 1.0, clock: Any = None, now_ns: Any = None, **choices: Any
    ) -> Drive:
        parts = courses(self._program, ACTIONS, speed)
        names = names_of(parts, self._program.plan.joint_names)
        file = DriveFile(self.path, self._scenario, self._program.plan, names)
        given = {"clock": clock, "now_ns": now_ns}
        further = {name: of for name, of in given.items() if of is not None}
        choices = {"patience_s": HANG_S, "delay_s": HANG_S} | choices
        self.drive = Drive(
            self.station, parts, DriveSettings(**choices), file, self.gate, **further
        )
        return self.drive

    def __call__(self, **choices: Any) -> Drive:
        drive = self.drive_of(**choices)
        try:
            drive.run()
        finally:
            drive._file.close()
        return drive

    def recorded(self) -> tuple[dict[str, int], dict[str, str]]:
        """Number of messages by topic, and what is said of the end."""
        with self.path.open("rb") as stream:
            reader = make_reader(stream)
            counts: dict[str, int] = {}
            for _, channel, _ in reader.iter_messages():
                counts[channel.topic] = counts.get(channel.topic, 0) + 1
            notes = {note.name: note.metadata for note in reader.iter_metadata()}
        return counts, notes["twinct drive outcome"]


@pytest.fixture
def run(domain: int, scenario: Scenario, program: Program, tmp_path: Path) -> Iterator[Run]:
    run = Run(domain, scenario, program, tmp_path)
    yield run
    run.station.close()


def test_both_controllers_get_the_plan_with_one_start(arms, run, program) -> None:
    both = arms(0), arms(1)
    drive = run(speed=0.5)
    stamps = set()
    for arm, stand_in in enumerate(both):
        (goal,) = stand_in.goals
        trajectory = goal.goal.trajectory if hasattr(goal, "goal") else goal.trajectory
        stamps.add((trajectory.header.stamp.sec, trajectory.header.stamp.nanosec))
        assert trajectory.joint_names == list(program.names[arm])
        points = trajectory.points
        state = program.states(arm)
        np.testing.assert_array_equal([p.positions for p in points], state[:, 0])
        np.testing.assert_allclose([p.velocities for p in points], state[:, 1] / 2)
        np.testing.assert_allclose([p.accelerations for p in points], state[:, 2] / 4)
        last = points[-1].time_from_start
        assert last.sec + last.nanosec / 1e9 == pytest.approx(2 * program.plan.duration_s)
    assert len(stamps) == 1
    assert stamps != {(0, 0)}
    counts, end = run.recorded()
    assert counts["/joint_states"] > 2 * 500 * program.plan.duration_s
    assert end["ended"] == "all controllers succeeded"
    assert "not checked" in drive.notes[0]


def test_a_controller_that_rejects_keeps_both_arms_where_they_are(arms, run) -> None:
    left, right = arms(0, does="silent"), arms(1, does="reject")
    with pytest.raises(ControllerError, match=f"{ACTIONS[1]} rejected the plan"):
        run()
    until(left.cancelled.is_set, "the cancelling of the other arm")
    assert right.goals
    assert "rejected" in run.recorded()[1]["ended"]
    assert run.drive.notes[-1] == f"{ACTIONS[0]} was asked to stop, and confirmed it"


def test_controllers_that_answer_too_late_do_not_start(arms, run) -> None:
    both = arms(0, does="silent"), arms(1, does="silent")
    with pytest.raises(ControllerError, match="did not answer the plan .* both were asked to stop"):
        run(delay_s=0.0)
    for arm in both:
        until(arm.cancelled.is_set, "the cancelling of an arm that accepts too late")


def test_a_controller_that_goes_on_is_named(arms, run) -> None:
    arms(0, does="stubborn"), arms(1, does="reject")
    with pytest.raises(ControllerError, match="rejected the plan"):
        run()
    assert f"{ACTIONS[0]} did not confirm the stop: stop this arm by hand" in run.drive.notes


class SetBack:
    """Clock that is set back while an arm moves, or while it rests."""

    def __init__(self, by_s: float, *, moving: bool) -> None:
        self._by_s, self._moving, self._told = by_s, moving, 0

    def __call__(self, true_s: float) -> float:
        moves = true_s > 1e6  # a goal's start is a date
        self._told += moves == self._moving
        return true_s - (self._by_s if self._told > 5 and moves == self._moving else 0)


def test_a_stamp_that_comes_a_little_late_is_named(arms, run) -> None:
    arms(0, clock=SetBack(0.004, moving=True)), arms(1)
    drive = run()
    assert drive.notes[-1].startswith("2 messages on /joint_states have stamps that do not")


def test_a_clock_that_is_set_back_stops_both_arms(arms, run) -> None:
    both = arms(0, does="silent", clock=SetBack(3.0, moving=True)), arms(1, does="silent")
    with pytest.raises(ControllerError, match=r"left_shoulder_pan_joint .* back by 2.99. s: the"):
        run()
    for arm in both:
        until(arm.cancelled.is_set, "the cancelling of both arms")
    counts, end = run.recorded()
    assert counts["/joint_states"] > 200  # nothing that came is lost
    assert "was set back" in end["ended"]


def test_a_clock_that_is_set_back_at_rest_sends_nothing(arms, run) -> None:
    both = arms(0, clock=SetBack(3600.0, moving=False)), arms(1)
    with pytest.raises(InputError, match=r"went back by .* nothing was sent"):
        run()
    assert not any(arm.goals for arm in both)


@pytest.mark.parametrize("by_s", [-3600, 3600])
def test_the_patience_of_a_drive_is_no_date(arms, run, by_s: int) -> None:
    """The clock of this machine is set back or forward once the goals are sent."""
    left, _ = arms(0, does="silent"), arms(1)
    now, date_ns = [0.0], [0]

    def clock() -> float:
        # Time passes only once both have accepted the plan, a second at a look.
        now[0] += 1.0 if all(part.result for part in run.drive._parts) else 0.0
        return now[0]

    def now_ns() -> int:
        date_ns[0] += 2_000_000_000 * 1_000_000_000 if not date_ns[0] else by_s * 1_000_000_000
        return date_ns[0]

    with pytest.raises(ControllerError, match=rf"{ACTIONS[0]} stopped half-way: it has no result"):
        run(clock=clock, now_ns=now_ns)
    until(left.cancelled.is_set, "the cancelling of the other arm")
    longest_s = max(part.course.duration_s for part in run.drive._parts)
    # Until the start, the motion, and three times the patience: result, cancelling, last words.
    assert HANG_S + longest_s < now[0] < 5 * HANG_S + longest_s


def test_who_records_images_hears_them_out_by_a_clock_of_its_own(run) -> None:
    """A detector whose clock is ahead seems to have sent everything."""
    now = [0.0]

    def clock() -> float:
        now[0] += 0.25
        return now[0]

    drive = run.drive_of(clock=clock, record=("/detector/image",))
    drive._start = Stamp(1, 0)
    drive._sent_ns["/detector/image"] = 2**62
    drive._heard_at["/detector/image"] = np.inf  # and it goes on
    drive._hear_out()
    assert now[0] > QUIET_S


def test_an_abort_is_named_and_stops_the_other_arm(arms, run) -> None:
    left = arms(0, does="silent")
    arms(1, does="abort")
    named = r"aborted, PATH_TOLERANCE_VIOLATED \(-4\): elbow is 0.3 rad off"
    with pytest.raises(ControllerError, match=named):
        run()
    until(left.cancelled.is_set, "the cancelling of the other arm")
    counts, end = run.recorded()
    assert counts["/joint_states"] > 200  # nothing that came is lost
    assert "PATH_TOLERANCE_VIOLATED" in end["ended"]


def test_a_controller_that_stops_half_way_is_named(arms, run) -> None:
    left, _ = arms(0, does="silent"), arms(1)
    now = [0.0]

    def clock() -> float:
        # Time passes only once both have accepted the plan.
        now[0] += HANG_S if all(part.result for part in run.drive._parts) else 0.0
        return now[0]

    with pytest.raises(ControllerError, match=rf"{ACTIONS[0]} stopped half-way: it has no result"):
        run(clock=clock)
    until(left.cancelled.is_set, "the cancelling of the other arm")


def test_an_arm_elsewhere_is_named_and_nothing_is_sent(arms, run, program) -> None:
    home = program.states(0)[0, 0] + np.radians([0, 0, 1.5, 0, 0, 0])
    left, right = arms(0, home=home), arms(1)
    name = program.names[0][2]
    with pytest.raises(InputError, match=rf"{name} stands 1.500 deg from the start .*0.5 deg"):
        run()
    assert not left.goals
    assert not right.goals


def test_two_owners_of_an_arm_are_noticed_and_nothing_is_sent(arms, run, program) -> None:
    """A second driver states the joints of the left arm, elsewhere."""
    stands = arms(0), arms(1)
    home = program.states(0)[0, 0]
    other = arms(0, home=home + 0.3, action="/other/follow_joint_trajectory")
    with pytest.raises(InputError, match=r"although nothing was sent: something else moves"):
        run()
    assert not any(stand_in.goals for stand_in in (*stands, other))


def test_unknown_joints_are_named(arms, run, program) -> None:
    arms(0, joints=[name.replace("left_", "") for name in program.names[0]])
    arms(1)
    now = [0.0]

    def clock() -> float:
        # Time passes only once all joints are heard of.
        now[0] += HANG_S if len(run.drive._at) == 12 else 0.0
        return now[0]

    stated = "no driver reports where left_shoulder_pan_joint, .* reported:"
    with pytest.raises(InputError, match=stated):
        run(clock=clock)


def test_limits_of_the_driver_are_respected(arms, run, program) -> None:
    names = [*program.names[0], *program.names[1]]
    slow = LIMITS.format("".join(LIMIT.format(name, 0.001) for name in names))
    arms(0, description=slow), arms(1)
    with pytest.raises(InputError, match=r"its limit is 0.06 deg/s \(/robot_description\)"):
        run()
    assert not run.drive.sent


def test_what_the_gate_of_the_cell_refuses_is_not_sent(arms, run) -> None:
    """Also if the drivers state no limits."""
    arms(0), arms(1)
    limits = run.gate.limits
    run.gate = Gate(replace(limits, accelerations=limits.accelerations / 100), run.gate.cycle_s)
    with pytest.raises(
        InputError, match=r"follow_joint_trajectory: .* would change its speed by .* \(the scenario"
    ):
        run()
    assert not run.drive.sent


def test_a_controller_that_is_not_there_is_named(arms, run) -> None:
    arms(0)
    now = [0.0]

    def clock() -> float:
        now[0] += HANG_S / 4
        return now[0]

    with pytest.raises(ControllerError, match=f"no controller answers at .*{ACTIONS[1]}"):
        run(clock=clock)


def test_the_names_of_the_joints_are_in_the_file(arms, run, plan) -> None:
    arms(0), arms(1)
    run()
    with run.path.open("rb") as stream:
        notes = {note.name: note.metadata for note in make_reader(stream).iter_metadata()}
    assert list(json.loads(notes["twinct drive"]["joints"]).values()) == list(plan.joint_names)


def full(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def stopped(*_: Any, **__: Any) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("where", "does", "error"),
    [
        ("twinct.link.recording.drive_file.save_plan", stopped, KeyboardInterrupt),
        ("twinct.link.participant.Station", stopped, KeyboardInterrupt),
        ("twinct.link.driving.Drive.run", stopped, KeyboardInterrupt),
        ("twinct.link.recording.drive_file.save_plan", full, StorageError),
        ("twinct.link.driving.Drive.run", full, StorageError),
    ],
)
def test_a_command_that_ends_before_it_sent_leaves_no_file(
    scenario, program, domain, tmp_path, monkeypatch, where: str, does: Any, error: type
) -> None:
    gate = gate_of(SimulationBuilder(scenario).cell, scenario.motion)
    here = "twinct.cli.commands.drive"
    monkeypatch.setattr(f"{here}.scenario_at", lambda *_: nullcontext(scenario))
    monkeypatch.setattr(f"{here}.motion_program", lambda *_: (program, gate))
    monkeypatch.setattr(where, does)
    with pytest.raises(error):
        drive(Path("s.yaml"), out=tmp_path / "d.mcap", source=ACTIONS[0], detector=ACTIONS[1])
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_closes_the_file(tmp_path, monkeypatch) -> None:
    bag = Bag(tmp_path / "d.mcap", 100)
    monkeypatch.setattr(bag._writer, "finish", full)
    with pytest.raises(OSError, match="No space"):
        bag.close()
    assert bag._file.closed


@pytest.mark.tutorial
def test_the_command_drives_one_controller_of_both_arms(arms, program, tmp_path, capfd) -> None:
    (tmp_path / "s.yaml").write_text(json.dumps(SCENARIO))
    names = [*program.names[0], *program.names[1]]
    cell = arms(0, joints=names, home=program.plan.home, action="/cell/follow_joint_trajectory")
    out = tmp_path / "drive.mcap"
    command = ["drive", str(tmp_path / "s.yaml"), "--out", str(out)]
    assert run_command(command) == 2
    assert "either --source and --detector, or --both" in capfd.readouterr().err
    command += ["--both", "/cell/follow_joint_trajectory"]
    assert run_command(command) == 2
    assert "both arms have a joint elbow_joint" in capfd.readouterr().err
    assert not out.exists()
    command += ["--source-prefix", "left_", "--detector-prefix", "right_"]
    command += ["--patience-s", str(HANG_S)]
    assert run_command(command) == 0
    assert "the controllers followed the plan" in capfd.readouterr().out
    assert len(cell.goals) == 1
    assert run_command(command) == 2
    assert "exists already" in capfd.readouterr().err
