"""Words of the page about a design, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twinct.design.desk import Answer, State
from twinct.design.draft import Draft
from twinct.design.edits import Line
from twinct.design.proposals import Proposal, Standing
from twinct.design.whole_run import WholeRun
from twinct.design.workbench import Price, Workbench
from twinct.viewer.markdown import plain

AROUND = 2
"""Unchanged lines that are shown around the changed ones."""


def state_of(bench: Workbench) -> str:
    """Return reach, time and clearance in one line, with the states of the answers."""
    views, motion = bench.answer("views"), bench.answer("motion")
    said: list[str] = []
    if views.value is not None and views.state is not State.FAILED:
        held = int(np.asarray(views.value).sum())
        said.append(f"{held} of {len(views.value)} views within reach{_in_brackets(views)}")
    if motion.state is State.FAILED:
        said.append("no motion plan")
    elif motion.value is not None and motion.value.plan is not None:
        said.append(
            f"motion {motion.value.duration_s:.1f} s, smallest clearance "
            f"{motion.value.clearance_mm:.1f} mm{_in_brackets(motion)}"
        )
    elif motion.value is not None and motion.state is State.FRESH and motion.value.problems:
        said.append("no motion plan")
    elif motion.state is State.COMPUTING:
        said.append("planning the motion")
    return "; ".join(said)


def _in_brackets(answer: Answer) -> str:
    return "" if answer.state is State.FRESH else f" ({answer.state})"


def problems_of(bench: Workbench) -> tuple[str, ...]:
    """Return all problems of the draft and of its answers, one sentence each."""
    if bench.draft.problems:
        return bench.draft.problems
    failed: dict[str, list[str]] = {}
    for subject in ("motion", "image", "views", "volume", "check"):
        answer = bench.answer(subject)
        for problem in answer.problems if answer.state is State.FAILED else ():
            failed.setdefault(problem, []).append(subject)
    found = [f"{', '.join(subjects)}: {problem}" for problem, subjects in failed.items()]
    motion = bench.answer("motion").value
    return tuple(dict.fromkeys([*found, *(motion.problems if motion is not None else ())]))


def prices_in_words(prices: Sequence[Price]) -> str:
    """Return the prices as a table: now, and the change against the saved state."""
    rows = [f"| {one.name} | {_now(one)} | {_change(one)} |" for one in prices]
    return "\n".join(["| | now | since saving |", "|---|---|---|", *rows])


def _now(price: Price) -> str:
    if price.why:
        return f"none: {plain(price.why)}"
    if math.isnan(price.now):
        return "none" if price.state is State.FRESH else str(price.state)
    mark = "" if price.state is State.FRESH else f" ({price.state})"
    return f"{_short(price.now)} {price.unit}{mark}".strip()


def _change(price: Price) -> str:
    if math.isnan(price.change):
        return ""
    sign = "+" if price.change > 0 else ""
    return "0" if abs(price.change) < 1e-9 else f"{sign}{_short(price.change)} {price.unit}".strip()


def _short(number: float) -> str:
    """Return three digits of a number, or all before the point."""
    return f"{number:.3g}" if abs(number) < 999.5 else f"{number:.0f}"


def proposal_in_words(proposal: Proposal) -> str:
    """Return a proposal as a table, now and then, with its changed keys."""
    now, then = proposal.now, proposal.then
    rows = [
        f"| {name} | {one(now)} | {one(then)} |"
        for name, one in (
            ("views within reach", _held),
            ("motion time", lambda of: _number(of.motion.duration_s, "s")),
            ("smallest clearance", lambda of: _number(of.motion.clearance_mm, "mm")),
        )
    ]
    why = [f"**{plain(problem)}**" for problem in then.motion.problems[:1]]
    table = "\n".join(["| | now | proposed |", "|---|---|---|", *rows])
    keys = code("\n".join(f"{key}: {value}" for key, value in proposal.edit.values.items()), "yaml")
    return "\n\n".join([*map(plain, proposal.words), table, *why, keys])


def _held(standing: Standing) -> str:
    return f"{int(standing.held.sum())} of {len(standing.held)}"


def _number(value: float, unit: str) -> str:
    return "none" if math.isnan(value) else f"{value:.1f} {unit}"


def run_in_words(run: WholeRun, answer: Answer) -> str:
    """Return the state of a run."""
    place = f"folder {plain(run.out.parent.name)}/{plain(run.out.name)}"
    if answer.state is State.COMPUTING:
        return f"{place}: *{plain(answer.progress or 'it begins')}*"
    if answer.state is State.FRESH:
        return f"{place}: finished in {answer.seconds:.0f} s; its report is report.html"
    why = "; ".join(answer.problems) or "cancelled; its views are kept, and *run* goes on with them"
    return f"{place}: **{plain(why)}**" if answer.problems else f"{place}: {why}"


def draft_in_words(draft: Draft, changed_outside: bool) -> str:
    """Return the state of the file and its draft."""
    if changed_outside:
        said = "**Another program has changed the file.** Take its text over, or replace it."
    elif draft.is_saved:
        said = "saved"
    else:
        said = "new, not saved yet" if draft.saved is None else "changed, not saved yet"
    lines = [f"{plain(draft.path.name)}: {said}"]
    if draft.unkept:
        lines.append(f"**{plain(draft.unkept)}**")
    lines += [f"**does not fit to the file: {plain(edit.words)}**" for edit in draft.dropped]
    return "  \n".join(lines)


def changes_in_words(lines: Sequence[Line]) -> str:
    """Return the changed lines of a comparison with a few lines around them."""
    changed = [k for k, line in enumerate(lines) if line.mark != " "]
    if not changed:
        return "*No change since the file was saved.*"
    near = {k + d for k in changed for d in range(-AROUND, AROUND + 1)}
    shown: list[str] = []
    for k, line in enumerate(lines):
        if k in near:
            shown.append(f"{line.mark} {line.text}")
        elif k - 1 in near:
            shown.append("...")
    return code("\n".join(shown), "diff")


def code(text: str, language: str = "") -> str:
    """Return a text as a block of code, whatever it contains."""
    fence = "```"
    while fence in text:
        fence += "`"
    return f"{fence}{language}\n{text}\n{fence}"
