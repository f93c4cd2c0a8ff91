"""Figures that need repetitions of a scan: which, and whether there can be any."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinct.core.errors import InputError
from twinct.evaluation import figure_kinds
from twinct.scenario import Scenario


def repeats_asked(scenario: Scenario) -> list[str]:
    """Return the keys of the section ``evaluation`` whose figures need repetitions."""
    section = scenario.evaluation
    every = figure_kinds().values() if section else ()
    return [kind.name for kind in every if kind.repeats and section and section.entries(kind.name)]


def repeated_figures(image: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a judged volume that need repetitions, by kind.

    Figures of versions that defined them otherwise are left out.
    """
    known: dict[str, Any] = {}
    for kind in figure_kinds().values():
        if kind.repeats and (entries := image.get(kind.name)):
            keys = {one.key for one in kind.figures}
            if all(keys <= figures.keys() for figures in entries.values()):
                known[kind.name] = entries
    return known


def check_repeats(scenario: Scenario) -> None:
    """Check that the images of a scan can be taken again from what its store keeps.

    Raises:
        InputError: figures need repetitions, and there can be none.
    """
    problems: list[str] = []
    for key in repeats_asked(scenario):
        if scenario.specimen.motion:
            problems.append(
                f"evaluation.{key}: a signal in a patient who breathes is not simulated"
            )
        if scenario.detector.lag and scenario.source.motion_samples > 1:
            problems.append(
                f"evaluation.{key}: with detector.lag and source.motion_samples, images cannot be "
                "taken again, as a scan does not store the pose at the end of an exposure"
            )
    if problems:
        raise InputError(problems)
