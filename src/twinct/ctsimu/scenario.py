"""A CTSimU scenario: read, checked, and given frame by frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinct.ctsimu.reader import Moment, Section
from twinct.ctsimu.scene import FieldImages, Frame
from twinct.ctsimu.sections import read_frame
from twinct.errors import ScenarioError
from twinct.geometry import ScanGeometry

FORMAT = (1, 2)
"""Newest version of the file format that is understood; older ones down to 1.0 are subsets."""


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

    def _root(self, moment: Moment, problems: list[str]) -> Section:
        return Section(self.data, "", moment, self.path.parent, problems)


def load_ctsimu(path: str | Path) -> CtsimuScenario:
    """Read a CTSimU scenario file, all frames of it.

    Raises:
        ScenarioError: with one sentence for each thing that is wrong, missing or not supported.
    """
    path = Path(path).expanduser()
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ScenarioError(f"{path}: cannot read the scenario: {reason}") from None
    except json.JSONDecodeError as error:
        raise ScenarioError(f"{path}:{error.lineno}: not valid JSON: {error.msg}") from None
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: a CTSimU scenario is a JSON object")
    problems: list[str] = []
    frames = _frames(data)
    scenario = CtsimuScenario(path, data, frames, 1, *2 * [FieldImages(0, 1, False, False)])
    root = scenario._root(Moment(0, frames), problems)
    _check_version(root.section("file"))
    acquisition = root.section("acquisition")
    average = acquisition.whole("frame_average", 1)
    dark, flat = (_field_images(acquisition.section(f"{kind}_field")) for kind in ("dark", "flat"))
    if frames < 1 or average < 1:
        acquisition.problem("number_of_projections, frame_average", "must be at least 1")
    if flat.correction and not flat.number:
        acquisition.problem("flat_field.correction", "needs flat_field.number of at least 1")
    if not problems:
        for index in range(frames):
            read_frame(scenario._root(Moment(index, frames), problems))
    if problems:
        raise ScenarioError([f"{path}: {problem}" for problem in problems])
    return CtsimuScenario(path, data, frames, average, dark, flat)


def _frames(data: Mapping[str, Any]) -> int:
    acquisition = data.get("acquisition")
    number = acquisition.get("number_of_projections") if isinstance(acquisition, Mapping) else None
    return int(number) if isinstance(number, int | float) and number >= 1 else 1


def _check_version(section: Section) -> None:
    kind = section.text("file_type")
    if kind != "CTSimU Scenario":
        section.problem("file_type", f"{kind!r} is not 'CTSimU Scenario'")
    version = section.section("file_format_version")
    found = version.whole("major", 0), version.whole("minor", 0)
    if not (1, 0) <= found <= FORMAT:
        section.problem("file_format_version", f"{found[0]}.{found[1]} is not one of 1.0, 1.1, 1.2")


def _field_images(section: Section) -> FieldImages:
    return FieldImages(
        section.whole("number", 0),
        section.whole("frame_average", 1),
        section.flag("ideal", False),
        section.flag("correction", False),
    )
