"""Titles, units and better values of figures, by dotted names such as "image.rmse_rel"."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from twinct.evaluation import IMAGE_FIGURES, MOTION_FIGURES, Figure, figure_kinds
from twinct.evaluation.figure import REFERENCE, Best
from twinct.report.page import stage_title
from twinct.report.pose_words import EXECUTED, against_executed

_BEST_OF_RUN: Mapping[str, Best] = {
    "reached": "higher",
    "clearance_mm": "higher",
    "real_time_factor": "higher",
    "pose_error": "lower",
    "simulated_seconds": "lower",
    "seconds": "lower",
}
"""Better values of the figures of a run, by the sections of ``metrics.json``."""

_UNITS = {"_mm_s": "mm/s", "_per_mm": "1/mm", "_mm": "mm", "_deg": "deg"}
_UNITS |= {"_kev": "keV", "_ma": "mA", "_ms": "ms", "_s": "s"}
"""Units by the endings of names, longer endings first."""

_STATISTICS = {"min": "smallest", "max": "largest", "mean": "mean", "std": "spread"}


def figure_words(name: str, reference: str = REFERENCE) -> Figure:
    """Return a figure in words; an unknown figure gets the words of its name.

    Args:
        name: dotted, as in ``metrics.json``.
        reference: name of the material that image figures are relative to.
    """
    parts, of, comparable = name.split("."), "", True
    if parts[0] == "geometries" and parts[2:3] == ["pose_error"]:
        shown = _of_run(parts[2:], against_executed(parts[1]))
        return replace(shown, key=name)
    if len(parts) > 2 and parts[0] in ("image_by_geometry", "geometries"):
        of = f"{parts[1]} geometry"
        parts = [*(["image"] if parts[0] == "image_by_geometry" else []), *parts[2:]]
    if parts[0] == "believed_minus_executed":
        of, parts, comparable = "believed minus executed", ["image", *parts[1:]], False
    if parts[:2] == ["image", "zero"]:
        of, parts, comparable = "empty volume", ["image", *parts[2:]], False
    shown = (_of_image(parts[1:]) if parts[0] == "image" else None) or _of_run(parts)
    shown = shown.relative_to(reference)
    title = f"{shown.title}, {of}" if of else shown.title
    return replace(shown, key=name, title=title, best=shown.best if comparable else "")


def with_companions(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of figures, each followed by those beside which alone it is shown."""
    shown: dict[str, None] = {}
    for name in names:
        shown[name] = None
        *entry, _ = name.split(".")
        volume = entry[: 2 if entry[:1] == ["image_by_geometry"] else 1]
        for key in figure_words(name).beside:
            place = volume if key.startswith("/") else entry
            shown[".".join([*place, key.removeprefix("/")])] = None
    return tuple(shown)


def axis_words(axes: Sequence[Sequence[str]]) -> list[tuple[str, str]]:
    """Return name and unit of each axis of a study, from the scenario keys that it sets.

    The last part of a key names it, with the part before where two axes would have equal names.
    """
    short = [_of_keys(keys, 1) for keys in axes]
    return [
        words if short.count(words) == 1 else _of_keys(keys, 2)
        for words, keys in zip(short, axes, strict=True)
    ]


def _of_keys(keys: Sequence[str], parts: int) -> tuple[str, str]:
    words = dict.fromkeys(_without_unit(" ".join(key.split(".")[-parts:])) for key in keys)
    units = {unit for _, unit in words}
    return ", ".join(name for name, _ in words), units.pop() if len(units) == 1 else ""


def _without_unit(name: str) -> tuple[str, str]:
    """Return a name in words without its unit, and the unit."""
    ending = next((end for end in _UNITS if name.endswith(end)), "")
    return name.removesuffix(ending).replace("_", " "), _UNITS.get(ending, "")


def _of_image(parts: list[str]) -> Figure | None:
    """Return a figure of a volume; None if it is unknown."""
    kind = figure_kinds().get(parts[0]) if len(parts) == 3 else None
    if one := next((one for one in kind.figures if one.key == parts[2]), None) if kind else None:
        return replace(one, title=f"{one.title}, {parts[1].replace('_', ' ')}")
    known = (*IMAGE_FIGURES, *MOTION_FIGURES)
    return next((one for one in known if one.key == ".".join(parts)), None)


def _of_run(parts: list[str], pose_error: str = EXECUTED) -> Figure:
    best = _BEST_OF_RUN.get(parts[0], "")
    if parts[0] == "seconds" and len(parts) == 2:
        return Figure("", f"time: {stage_title(parts[1])}", "s", digits=1, best=best)
    unit, words = "", list[str]()
    for part in parts:
        word, own = (pose_error, "") if part == "pose_error" else _without_unit(part)
        unit = own or unit
        words.append(word)
    if words[-1] in _STATISTICS:
        words.append(_STATISTICS[words.pop()])
    return Figure("", ", ".join(words), unit, best=best)
