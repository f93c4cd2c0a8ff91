"""A CTSimU scenario: read, checked, and given frame by frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinct.ctsimu.acquisition import read_plan
from twinct.ctsimu.jsonfile import read_json
from twinct.ctsimu.reader import JsonSection, Moment
from twinct.ctsimu.references import wrong_references
from twinct.ctsimu.scene import FieldImages, Frame
from twinct.ctsimu.sections import read_frame
from twinct.errors import ScenarioError
from twinct.geometry import ScanGeometry


@dataclass(frozen=True, eq=False)
class CtsimuScenario:
    """A scenario file that was read and is supported in full.

    Attributes:
        path: the file.
        data: its content.
        frames: number of projections.
        average: frames averaged for each projection.
        dark: dark images.
        flat: flat images.
    """

    path: Path
    data: Mapping[str, Any]
    frames: int
    average: int
    dark: FieldImages
    flat: FieldImages

    @property
    def name(self) -> str:
        """Stem of the file: images are called after it."""
        return self.path.stem

    def frame(self, index: float, believed: bool = False) -> Frame:
        """All of one frame.

        Args:
            index: counted from 0.
            believed: as reconstruction is told: without unknown deviations and drifts.

        Raises:
            ScenarioError: what only this frame says is wrong or not supported.
        """
        problems: list[str] = []
        frame = read_frame(self._root(Moment(index, self.frames, believed), problems))
        if problems or frame is None:
            raise ScenarioError([f"{self.path}: {p}" for p in problems])
        return frame

    def geometry(self, believed: bool = False) -> ScanGeometry:
        """All views in the frame of the stage, where the reconstructed volume is at rest.

        Args:
            believed: as reconstruction is told; otherwise as executed.
        """
        frames = [self.frame(i, believed) for i in range(self.frames)]
        views = [frame.world_from_stage.inverse() @ frame.view for frame in frames]
        arrays = {
            name: np.concatenate([getattr(view, name) for view in views])
            for name in ("source", "detector", "u", "v")
        }
        return ScanGeometry(**arrays, panel=views[0].panel)

    def _root(self, moment: Moment, problems: list[str]) -> JsonSection:
        return JsonSection(self.data, "", moment, self.path.parent, problems)


def load_ctsimu(path: str | Path) -> CtsimuScenario:
    """Read a CTSimU scenario file, all frames of it.

    Raises:
        ScenarioError: with one sentence for each thing that is wrong, missing or not supported.
    """
    path = Path(path).expanduser()
    data = read_json(path, skipped="simulation")
    # What is wrong with the plan is told with all else that is wrong in frame 0.
    plan = read_plan(JsonSection(data, "", Moment(0, 1), path.parent, []).section("acquisition"))
    scenario = CtsimuScenario(path, data, plan.frames, plan.average, plan.dark, plan.flat)
    seen: set[object] = set()
    for index in range(plan.frames):
        problems: list[str] = []
        frame = read_frame(scenario._root(Moment(index, plan.frames), problems))
        if frame is not None:
            problems += wrong_references(frame, seen)
        if problems:
            # Later frames repeat what is wrong in this one, with other numbers.
            when = f" (frame {index})" if index else ""
            raise ScenarioError(f"{path}: {problem}{when}" for problem in problems)
    return scenario
