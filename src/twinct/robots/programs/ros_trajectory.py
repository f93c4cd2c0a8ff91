"""A motion plan as ``trajectory_msgs/msg/JointTrajectory``, in YAML, for each arm and for both.

``ros2 action send_goal`` and ``rosidl_runtime_py.set_message_fields`` take such a file. Between two
points, controllers that know positions, velocities and accelerations interpolate by the quintic
that the plan itself follows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from twinct.geometry import Floats
from twinct.robots.motion.branches import SIDES
from twinct.robots.programs.language import Language
from twinct.robots.programs.program import TRIGGERS, Program, triggers

NANOSECONDS = 1_000_000_000


def _write(program: Program) -> Mapping[str, str]:
    source, detector = program.names
    both = (*source, *detector)
    if len(set(both)) < len(both):  # one controller of both arms cannot have equal names
        both = program.plan.joint_names
    trajectories = {
        f"{side}_trajectory.yaml": _text(program, names, program.states(arm))
        for arm, (side, names) in enumerate(zip(SIDES, program.names, strict=True))
    }
    trajectories["both_trajectory.yaml"] = _text(program, both, program.plan.state)
    return trajectories | {TRIGGERS: triggers(program)}


def _text(program: Program, names: Iterable[str], states: Floats) -> str:
    return "\n".join(_lines(program, names, states)) + "\n"


def _lines(program: Program, names: Iterable[str], states: Floats) -> Iterator[str]:
    yield f"# trajectory_msgs/msg/JointTrajectory of {program.origin}"
    yield "header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}"
    yield f"joint_names: [{', '.join(names)}]"
    yield "points:"
    for time_s, (position, velocity, acceleration) in zip(
        program.plan.time_s.tolist(), states.tolist(), strict=True
    ):
        sec, nanosec = divmod(round(time_s * NANOSECONDS), NANOSECONDS)
        yield f"- positions: {_numbers(position)}"
        yield f"  velocities: {_numbers(velocity)}"
        yield f"  accelerations: {_numbers(acceleration)}"
        yield "  effort: []"
        yield f"  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}"


def _numbers(values: list[float]) -> str:
    # YAML 1.1 reads a number with an exponent only if it has a point and a sign.
    texts = (repr(value) for value in values)
    return f"[{', '.join(_with_point(text) for text in texts)}]"


def _with_point(text: str) -> str:
    mantissa, exponent, power = text.partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent}{power}"


ROS_TRAJECTORY = Language(
    "joint-trajectory", "trajectory_msgs/msg/JointTrajectory as YAML, for ROS 2 controllers", _write
)
