"""Predictions beside measurements, for the report: detectability, times, and rendered views."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.boundary import library_errors, no_file
from twinct.core.files.plain_json import read_json
from twinct.report.measured import nested
from twinct.report.style import Picture
from twinct.scenario import Scenario

_PLAN = "plan.json"
"""Result of ``twinct plan``, beside its views and the motion of its arms."""


def stored_predictions(folder: Path) -> list[tuple[str, Picture]]:
    """Return the predictions of ``twinct predict`` in a folder: in words, with their pictures."""
    pictures: list[tuple[str, Picture]] = []
    for path in sorted(folder.glob("[!.]*/prediction.json")):
        data = read_json(path)
        with library_errors(str(path)):
            residual = 100 * data["residual_rel"]
            words = f"{path.parent.name}: {data['in_words']}; residual {residual:.2f} %"
        picture = path.with_name("prediction.png")
        if not no_file(picture):
            pictures.append((words, Picture(picture.read_bytes(), "image/png")))
    return pictures


def drive_times(file: Path) -> dict[str, Any]:
    """Return the key ``drive`` of ``metrics.json``; nothing if no plan was followed by real arms.

    Raises:
        InputError: the file is damaged.
    """
    if no_file(file):
        return {}
    data = read_json(file)
    with library_errors(str(file)):
        figures: dict[str, Any] = {"lag_ms": data["lag_ms"], "latency_ms": data["latency_ms"]}
        if "planned_s" in data:
            planned_s, taken_s = (np.array(data[of], float) for of in ("planned_s", "taken_s"))
            late_ms = 1000 * (taken_s - planned_s)
            figures["late_ms"] = {
                "mean": late_ms.mean(),
                "std": late_ms.std(),
                "max": late_ms.max(),
            }
            figures["planned_s"], figures["taken_s"] = np.ptp(planned_s), np.ptp(taken_s)
    return {"drive": figures}


def planned_detectability(scenario: Scenario, image: Mapping[str, Any]) -> dict[str, Any]:
    """Return the key ``planned_detectability`` of ``metrics.json``; nothing without such a plan.

    Args:
        scenario: scenario of the run, whose views or motion are those of ``twinct plan``.
        image: figures of its volume, nested as in ``metrics.json``.

    Returns:
        ``predicted``, for penalised least squares, and ``measured``: d' of the detection tasks of
        the plan's signal, by name.

    Raises:
        InputError: the plan's result is damaged.
    """
    goal = getattr(scenario.task, "detectability", None)
    made = getattr(scenario.trajectory, "path", None), getattr(scenario.motion, "plan", None)
    files = [Path(path).with_name(_PLAN) for path in made if path is not None]
    file = next((file for file in files if not no_file(file)), None)
    if goal is None or file is None:
        return {}
    data = read_json(file)
    with library_errors(str(file)):
        predicted = float(data["goals"]["detectability"]["planned"])
    tasks = scenario.evaluation.entries("tasks") if scenario.evaluation else ()
    alike = [one.label for one in tasks if getattr(one, "signal", None) == goal.signal]
    measured = {name: nested(image, f"tasks.{name}.detectability") for name in alike}
    return {"planned_detectability": {"predicted": predicted, "measured": measured}}
