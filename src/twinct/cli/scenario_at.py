"""The scenario that a command is given."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

from twinct.scenario import Scenario, load_scenario, named_places


@contextmanager
def scenario_at(file: Path, overrides: Sequence[str]) -> Generator[Scenario, None, None]:
    """Yield the scenario of a file; problems in the block name their place in it.

    Raises:
        ScenarioError: the scenario is wrong.
    """
    scenario = load_scenario(file, overrides)
    with named_places(file, overrides):
        yield scenario
