"""A motion plan as URScript, one program for each arm, for controllers of Universal Robots.

The arm moves to the start, waits for a digital input that starts both arms together, follows the
plan by ``servoj``, and sets a digital output for a moment at each view. ``servoj`` and its ranges
are described in Universal Robots' script manual: the time of a call is at least 2 ms (e-Series),
``lookahead_time`` lies between 0.03 and 0.2 s, ``gain`` between 100 and 2000.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Floats
from twinct.robots.motion.branches import SIDES
from twinct.robots.programs.language import Language
from twinct.robots.programs.program import TRIGGERS, Program, triggers

JOINTS = 6
STEP_S = 0.016
"""Longest time of one call, s."""

SHORTEST_S = 0.002
"""Shortest time of one call that the controller takes, s."""

START_INPUT, TRIGGER_OUTPUT = 0, 0
LOOKAHEAD_S, GAIN = 0.1, 300
START_SPEED, START_ACCELERATION = 0.3, 0.5
"""Speed and acceleration of the move to the start, rad and s."""


def _write(program: Program) -> Mapping[str, str]:
    programs = {}
    for arm, (side, names) in enumerate(zip(SIDES, program.names, strict=True)):
        if len(names) != JOINTS:
            raise InputError(
                f"--to urscript: the {side} arm has {len(names)} joints; arms of Universal Robots "
                f"have {JOINTS}"
            )
        programs[f"{side}.script"] = "\n".join(_lines(program, side, arm)) + "\n"
    return programs | {TRIGGERS: triggers(program)}


def _lines(program: Program, side: str, arm: int) -> Iterator[str]:
    times, exposed = _calls(program)
    joints = program.plan.at(times)[:, 0, program.arms[arm]]
    yield f"# {program.origin}: the {side} arm, {program.plan.duration_s:.3f} s"
    yield f"# digital input {START_INPUT} starts it, digital output {TRIGGER_OUTPUT} takes a view"
    yield f"def twinct_{side}():"
    yield f"  set_digital_out({TRIGGER_OUTPUT}, False)"
    yield f"  movej({_joints(joints[0])}, a={START_ACCELERATION}, v={START_SPEED})"
    yield f"  while not get_digital_in({START_INPUT}):"
    yield "    sync()"
    yield "  end"
    triggered = False
    for step, target, view in zip(np.diff(times.round(6)), joints[1:], exposed[1:], strict=True):
        call = f"t={step:.6f}, lookahead_time={LOOKAHEAD_S}, gain={GAIN}"
        yield f"  servoj({_joints(target)}, {call})"
        if view >= 0 or triggered:
            triggered = view >= 0
            state = f"True)  # view {view}" if triggered else "False)"
            yield f"  set_digital_out({TRIGGER_OUTPUT}, {state}"
    yield "  stopj(2.0)"
    yield f"  set_digital_out({TRIGGER_OUTPUT}, False)"
    yield "end"


def _calls(program: Program) -> tuple[Floats, Floats]:
    """Return the time of each call, and the view that follows it, -1 for none.

    Each stretch between two views is divided into equal calls, at least two: every view falls on
    one, and the digital output falls before it rises again.

    Raises:
        InputError: views follow each other faster than calls.
    """
    plan = program.plan
    marks = np.concatenate([[0.0], plan.exposures_s, [plan.duration_s]])
    views = np.concatenate([[-1], plan.views[plan.waypoints], [-1]])
    between_s = np.diff(plan.exposures_s).min(initial=np.inf)
    if between_s < 2 * SHORTEST_S:
        raise InputError(
            f"--to urscript: views follow each other within {1000 * between_s:.1f} ms; two calls "
            f"of servoj take at least {2000 * SHORTEST_S:g} ms: set detector.frame_ms"
        )
    times, exposed = [0.0], [-1]
    for start, end, view in zip(marks[:-1], marks[1:], views[1:], strict=True):
        count = max(2, int(np.ceil((end - start) / STEP_S - 1e-9)))
        if end == start:  # a plan that ends at its last view
            continue
        times += (start + (end - start) * np.arange(1, count + 1) / count).tolist()
        exposed += [-1] * (count - 1) + [int(view)]
    return np.array(times), np.array(exposed)


def _joints(values: Floats) -> str:
    return f"[{', '.join(f'{value:.9f}' for value in values)}]"


URSCRIPT = Language("urscript", "programs for arms of Universal Robots", _write)
