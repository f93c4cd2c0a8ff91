"""A CTSimU scenario: read, checked, and available frame by frame.

All referenced curves and images are read before anything is rendered. Meshes are left to the
rendering: they take long, and a broken one is reported before its first image.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError, ScenarioError
from twinct.core.files.images import read_image
from twinct.core.files.tables import read_curve
from twinct.ctsimu.acquisition import Acquisition, read_acquisition
from twinct.ctsimu.jsonfile import read_json
from twinct.ctsimu.reader import JsonSection, Moment
from twinct.ctsimu.scene import Frame
from twinct.ctsimu.sections import read_frame
from twinct.geometry import ScanGeometry


@dataclass(frozen=True, eq=False)
class CtsimuScenario(Acquisition):
    """A fully supported scenario file with its content."""

    path: Path
    data: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Stem of the file name, and the prefix of the images."""
        return self.path.stem

    def frame(self, index: float, believed: bool = False) -> Frame:
        """Return one frame with all its settings, counted from 0.

        The believed frame is the one given to the reconstruction: without unknown deviations and
        drifts.

        Raises:
            ScenarioError: the frame is invalid or not supported.
        """
        problems: dict[str, None] = {}
        frame = read_frame(self._root(Moment(index, self.frames, believed), problems))
        if problems or frame is None:
            raise ScenarioError([f"{self.path}: {p}" for p in problems])
        return frame

    def geometry(self, believed: bool = False) -> ScanGeometry:
        """Return all views, executed or believed, in the stage's frame, where the volume rests."""
        frames = [self.frame(i, believed) for i in range(self.frames)]
        views = [frame.world_from_stage.inverse() @ frame.view for frame in frames]
        arrays = {
            name: np.concatenate([getattr(view, name) for view in views])
            for name in ("source", "detector", "u", "v")
        }
        return ScanGeometry(**arrays, panel=views[0].panel)

    def _root(self, moment: Moment, problems: dict[str, None]) -> JsonSection:
        return JsonSection(self.data, "", moment, self.path.parent, problems)


def load_ctsimu(path: str | Path) -> CtsimuScenario:
    """Read a CTSimU scenario file with all its frames.

    Raises:
        ScenarioError: with one sentence for everything that is invalid, missing or not supported.
    """
    path = Path(path).expanduser()
    data = read_json(path, skipped="simulation")
    # Problems of these numbers are reported together with all others of frame 0.
    numbers = read_acquisition(
        JsonSection(data, "", Moment(0, 1), path.parent, {}).section("acquisition")
    )
    scenario = CtsimuScenario(**vars(numbers), path=path, data=data)
    seen: set[object] = set()
    for index in range(numbers.frames):
        problems: dict[str, None] = {}
        frame = read_frame(scenario._root(Moment(index, numbers.frames), problems))
        if frame is not None:
            problems |= dict.fromkeys(_wrong_references(frame, seen))
        if problems:
            # Later frames would repeat these problems with other numbers.
            when = f" (frame {index})" if index else ""
            raise ScenarioError(f"{path}: {problem}{when}" for problem in problems)
    return scenario


def known_geometry(path: str | Path) -> ScanGeometry:
    """Return the views of a scenario as they are known to the reconstruction, in the stage's frame.

    The sections of tube, detector, samples and materials are not read, but for the panel: a scan
    that was measured or rendered needs none of them, nor their files.

    Raises:
        ScenarioError: with one sentence for everything that is invalid or missing.
    """
    path = Path(path).expanduser()
    data = _views_alone(read_json(path, skipped="simulation"))
    numbers = read_acquisition(
        JsonSection(data, "", Moment(0, 1), path.parent, {}).section("acquisition")
    )
    scenario = CtsimuScenario(**vars(numbers), path=path, data=data)
    across, down = scenario.frame(0, believed=True).binning
    return scenario.geometry(believed=True).binned(down, across)


def _views_alone(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario with the views of another, an ideal panel and one energy."""
    kept: dict[str, Any] = {key: data[key] for key in ("file", "geometry") if key in data}
    for name, unused in (
        ("acquisition", ("scattering", "scan_mode", "scan_speed")),
        ("detector", set(data.get("detector") or {}).difference(_PANEL)),
    ):
        section = data.get(name)
        if isinstance(section, Mapping):
            section = {key: value for key, value in section.items() if key not in unused}
        kept[name] = section
    return {**kept, "source": {"voltage": 100.0, "spectrum": {"monochromatic": True}}}


_PANEL = "columns", "rows", "pixel_pitch"


def _wrong_references(frame: Frame, seen: set[object]) -> list[str]:
    """Return one sentence per file with invalid content; add the files read to ``seen``."""
    response = frame.response
    reads: dict[str, tuple[object, Callable[[], object]]] = {}
    for key, path in (
        ("source.spectrum.file", frame.tube.spectrum),
        ("detector.gray_value.intensity_characteristics_file", response.curve),
        ("detector.gray_value.efficiency_characteristics_file", response.efficiency),
        ("detector.noise.noise_characteristics_file", response.noise),
        ("detector.unsharpness.mtf", response.mtf),
    ):
        if path is not None:
            reads[key] = path, partial(read_curve, path)
    if (spot := frame.spot.image) is not None:
        what = "a focal spot"
        reads["source.spot.intensity_map.file"] = spot, partial(read_image, spot, what)
    if (bad := response.bad_pixels) is not None:
        shape = frame.panel.shape
        reads["detector.bad_pixel_map.file"] = bad, partial(read_image, bad, "bad pixels", shape)
    problems = []
    for key, (file, read) in reads.items():
        if (key, file) not in seen:
            seen.add((key, file))
            try:
                read()
            except InputError as error:
                problems.extend(f"{key}: {problem}" for problem in error.problems)
    return problems
