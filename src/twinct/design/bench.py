"""Parts that a worker keeps for the next question: the last scenario's bodies, and an imager."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from twinct.design.progress_note import ProgressNote
from twinct.design.shared import SharedBuilder
from twinct.observers import Observers
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, ScenarioText, load_scenario

if TYPE_CHECKING:
    from twinct.xray import Imager

Made = TypeVar("Made")


@dataclass
class Bench:
    """Parts of the newest scenarios, which are built at their first use.

    Attributes:
        note: file for the progress of the present question; None: it is not noted.
        shelf: folder of specimens that several processes share; None: there is none.
    """

    note: Path | None = None
    shelf: Path | None = None
    _text: ScenarioText | None = None
    _scenario: Scenario | None = None
    _builder: SharedBuilder | None = None
    _imager: tuple[object, Any] | None = field(default=None, repr=False)
    _kept: dict[str, tuple[object, Any]] = field(default_factory=dict, repr=False)

    @property
    def observers(self) -> Observers:
        """Observers of work that takes longer."""
        return () if self.note is None else (ProgressNote(self.note).observer,)

    def scenario(self, source: ScenarioText) -> Scenario:
        """Return the scenario of a text.

        Raises:
            ScenarioError: the text is no valid scenario.
        """
        if self._scenario is None or self._text != source:
            self._scenario, self._text = load_scenario(source), source
        return self._scenario

    def builder(self, scenario: Scenario) -> SimulationBuilder:
        """Return the builder of a scenario, which takes over what the change leaves as it is."""
        if self._builder is None:
            self._builder = SharedBuilder(scenario, shelf=self.shelf)
        elif self._builder.scenario != scenario:
            self._builder = self._builder.of_changed(scenario)
        return self._builder

    def imager(self, builder: SimulationBuilder) -> Imager:
        """Return an open imager for a scenario; the last one, if nothing that it reads differs."""
        reads = _read_by_imager(builder.scenario)
        if self._imager is None or self._imager[0] != reads:
            self.close()
            self._imager = reads, builder.imager()
        return self._imager[1]

    def kept(self, kind: str, reads: object, make: Callable[[], Made]) -> Made:
        """Return the last result of a kind if it read what is given; else ``make`` it."""
        if kind not in self._kept or self._kept[kind][0] != reads:
            self._kept.pop(kind, None)  # the memory may not hold two
            self._kept[kind] = reads, make()
        return self._kept[kind][1]

    def close(self) -> None:
        """Close the imager; a process has at most one."""
        if self._imager is not None:
            self._imager[1].close()
            self._imager = None


def _read_by_imager(scenario: Scenario) -> tuple[object, ...]:
    """Return the sections that an imager reads."""
    common = (scenario.specimen, scenario.source, scenario.detector, scenario.xray)
    # An ideal image needs the views only to split large triangles, and allows any.
    if scenario.source.ideal and scenario.detector.ideal:
        return (*common, scenario.cell.keyed_objects)
    return (*common, scenario.cell, scenario.trajectory, scenario.seed)
