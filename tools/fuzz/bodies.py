"""Fuzzing of specimen and room: each scenario must build, or be refused with its key."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from cases import Case
from scenario_files import Kind as ScenarioFiles

from twinct.core.errors import InputError
from twinct.geometry import Panel
from twinct.runs import require_memory
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, load_scenario

SECTIONS = (("specimen", "parts", 0, "shape"), ("specimen",), ("cell",), ("detector",))


class Kind(ScenarioFiles):
    """Scenarios with changed bodies and rooms, built up to the models that the engines use."""

    seconds = 30.0
    memory_bytes = 2 * 2**30

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case with changed numbers in a valid section."""
        key = rng.choice(SECTIONS)
        told = self.valid_with(rng, folder / "mutant.yaml", key)
        return Case(told, lambda: _built(folder / "mutant.yaml"))


def _built(path: Path) -> str:
    scenario = load_scenario(path)
    require_memory(scenario)
    builder = SimulationBuilder(scenario)
    hull = builder.hull
    if not np.isfinite(hull.vertices).all():
        raise AssertionError("a hull that is not finite")
    if isinstance(scenario.cell, Cell):
        assert isinstance(scenario.detector.panel, Panel)
        _ = builder.cell
    try:
        _ = builder.requested
    except InputError:
        return "specimen and room"
    return "all"
