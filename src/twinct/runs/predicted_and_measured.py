"""Predictions beside measurements, for the report: times of a plan, and rendered views."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.boundary import library_errors, no_file
from twinct.core.files.plain_json import read_json
from twinct.report.style import Picture


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
