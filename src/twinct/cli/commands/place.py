"""``twinct place``: better positions of the arms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Flag, Json, Overrides, ScenarioFile
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal, say
from twinct.cli.scenario_at import scenario_at
from twinct.core.files.writing import storage_errors
from twinct.robots.reach import Bounds
from twinct.runs import reaching
from twinct.scenario import write_scenario

SECONDS = 15.0
"""Time of a search for the views of a trajectory: an answer comes within 20 s with the rest."""


def place(
    scenario: ScenarioFile,
    *,
    sphere: Flag = False,
    save: Annotated[Path | None, tyro.conf.arg(metavar="YAML")] = None,
    x: tuple[float, float] = (-1000.0, 1000.0),
    y: tuple[float, float] = (-1000.0, 1000.0),
    z: tuple[float, float] = (-800.0, 400.0),
    standoff: tuple[float, float] = (100.0, 300.0),
    tool_rotation: tuple[float, float] = (-180.0, 180.0),
    samples: int = 128,
    seed: int = 0,
    seconds: float | None = None,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Find good positions of the arms for a scenario's trajectory, or for most of the sphere.

    Args:
        sphere: Reach as many directions as possible; source and panel may turn about the beam.
        save: Write a scenario with the resulting keys.
        x: Lowest and highest position of a base, mm.
        y: Lowest and highest position of a base, mm.
        z: Lowest and highest position of a base, mm.
        standoff: Distance from flange to focal spot and panel centre, mm.
        tool_rotation: Turn of the tools about the flange axis, deg.
        samples: Positions of each single arm that are tried first.
        seed: Seed of the search.
        seconds: Time after which the search ends with the best places so far; 0: no limit. Unless
            it is given: 15 for the views of a trajectory, and no limit for the sphere.
    """
    bounds = Bounds(x, y, z, standoff, tool_rotation)
    if seconds is None:
        seconds = 0.0 if sphere else SECONDS
    with answering(as_json) as answer:
        with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
            found = reaching.place(
                loaded,
                sphere=sphere,
                bounds=bounds,
                samples=samples,
                seed=seed,
                seconds=seconds or None,
                observers=audience,
            )
        what = "directions" if sphere else "views"
        say(
            f"both arms reach {100 * found.before:.1f} % of {found.judged_on} {what} before, "
            f"{100 * found.after:.1f} % after; {found.placement.judged} cells were judged on "
            f"{found.searched_on} {what}, and one arm alone at {found.placement.alone} places, "
            f"seed {seed}"
        )
        if found.placement.stopped:
            say(f"the search ended after {seconds:g} s; --seconds 0 tries all places")
        if not found.moved:
            say("nothing better was found: the arms stay where they are")
        for override in found.overrides:
            say(override)
        if save is not None:
            with storage_errors(save):
                write_scenario(save, scenario, [*set_, *found.overrides])
            say(f"wrote {save}")
        answer |= {
            "share_before": found.before,
            "share_after": found.after,
            "judged_on": found.judged_on,
            "cells": found.placement.judged,
            "stopped": found.placement.stopped,
            "seed": seed,
            "set": found.overrides,
        }
