"""``twinct ctsimu render``: dark, flat and projection images of a scenario, one file each.

An image appears under its name only when it is complete, and all noise is keyed by seed, kind and
number. So an interrupted rendering resumes to identical bytes.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from twinct.core.draws import view_rng
from twinct.core.errors import ScanExistsError, ScenarioError
from twinct.core.files.images import RawImage, write_tiff
from twinct.core.files.lock import sole_owner
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import storage_errors, write_text
from twinct.ctsimu.camera import Camera
from twinct.ctsimu.digitiser import Digitiser, Image
from twinct.ctsimu.outputs import Options, OutputPaths, write_metadata
from twinct.ctsimu.scenario import CtsimuScenario
from twinct.ctsimu.scene import DarkOrFlatImages, Frame
from twinct.ctsimu.writing import make_folder
from twinct.xray.readout import binned

LAG_LEFT = 1e-6
"""Minimum share of an earlier projection that counts as lag."""


def render(
    scenario: CtsimuScenario,
    folder: Path,
    options: Options | None = None,
    *,
    resume: bool = False,
    step: Callable[[], None] = lambda: None,
) -> OutputPaths:
    """Render all images of a scenario.

    Args:
        scenario: the scenario.
        folder: output folder, created if missing.
        options: options that the scenario leaves open.
        resume: continue an interrupted rendering.
        step: called after each projection, including existing ones.

    Raises:
        FolderInUseError: another process works in the folder.
        ScanExistsError: the folder already holds a rendering, or images of something else.
        InputError: a file does not hold the data that the scenario states; names it.
        StorageError: the images cannot be written.
    """
    options, files = options or Options(), OutputPaths(folder, scenario.name)
    make_folder(folder)
    with storage_errors(folder), sole_owner(folder / "twinct.lock", alone=False):
        _claim(files, _identity(scenario, options), resume)
        with Camera(options.samples, options.spot_points) as camera:
            _Run(scenario, files, options, camera).all(step)
    return files


class _Run:
    """One rendering in progress."""

    def __init__(
        self, scenario: CtsimuScenario, files: OutputPaths, options: Options, camera: Camera
    ) -> None:
        self.scenario, self.files, self.options, self.camera = scenario, files, options, camera
        self.first = scenario.frame(0)
        free = camera.expose(self.first, samples_in=False)
        self.free_beam_j = float(free.max())
        self.free = self._mean(self.first, free)
        if not self.free_beam_j > 0:
            raise ScenarioError(f"{scenario.path}: no radiation reaches the detector")

    def all(self, step: Callable[[], None]) -> None:
        """Render all images that are missing."""
        nothing = self._detector(self.first).grey(np.zeros(self.first.panel.shape))
        dark = self._fields("dark", nothing, self.scenario.dark)
        flat = self._fields("flat", self.free, self.scenario.flat)
        before: deque[tuple[int, Image]] = deque()
        for index in range(self.scenario.frames):
            path = self.files.projection(index)
            if not path.exists():
                frame = self.scenario.frame(index)
                mean = self._with_lag(index, frame, before)
                image = self._noisy(frame, mean, "projection", index, self.scenario.average)
                write_tiff(path, self._corrected(frame, image, dark, flat))
            step()
        brightest = self._detector(self.first).brightest
        write_metadata(self.files, self.scenario, self.options, self.first, brightest)

    def _detector(self, frame: Frame) -> Digitiser:
        return Digitiser(frame.response, frame.panel, self.free_beam_j)

    def _mean(self, frame: Frame, energy_j: Image) -> Image:
        detector = self._detector(frame)
        return detector.grey(detector.blurred(energy_j))

    def _projection(self, index: int) -> Image:
        frame = self.scenario.frame(index)
        return self._mean(frame, self.camera.expose(frame))

    def _with_lag(self, index: int, frame: Frame, before: deque[tuple[int, Image]]) -> Image:
        """Return the mean of a projection's frames; each starts with the lag of the one before.

        A share l of a frame's signal remains in the next: y_k = (1 - l) g + l y_(k-1) for grey
        value g. The first projection starts in its steady state.
        """
        lag, average = frame.response.lag, self.scenario.average
        if lag == 0:
            return self._projection(index)
        reach = int(np.ceil(np.log(LAG_LEFT) / (average * np.log(lag))))
        while before and before[0][0] < index - reach:
            before.popleft()
        for earlier in range(max(index - reach, 0), index):
            if not any(i == earlier for i, _ in before):
                before.append((earlier, self._projection(earlier)))
        now = self._projection(index)
        left = before[0][1] if before else now
        for _, image in before:
            left = image + lag**average * (left - image)
        before.append((index, now))
        return now + (left - now) * lag * (1 - lag**average) / (average * (1 - lag))

    def _noisy(self, frame: Frame, mean: Image, kind: str, index: int, average: int) -> Image:
        """Return an image with the detector's noise and bad pixels, in the row order of CTSimU."""
        detector = self._detector(frame)
        deviation = detector.deviation(mean)
        image = mean
        if deviation is not None and average > 0:
            rng = view_rng(self.options.seed, f"ctsimu {kind}", index)
            image = mean + detector.noise(rng) * deviation / np.sqrt(average)
        image = image[::-1] if frame.upside_down else image
        return binned(detector.with_bad_pixels(image), *frame.binning)

    def _fields(self, kind: str, mean: Image, images: DarkOrFlatImages) -> Image | None:
        """Write the dark or flat images, and return their mean."""
        stack = []
        for index in range(images.number):
            path = self.files.field(kind, index, images.number)
            if not path.exists():
                average = 0 if images.ideal else images.average
                image = self._noisy(self.first, mean, kind, index, average)
                write_tiff(path, self._detector(self.first).stored(image))
            stack.append(tifffile.imread(path).astype(np.float64))
        return np.mean(stack, axis=0) if stack else None

    def _corrected(
        self, frame: Frame, image: Image, dark: Image | None, flat: Image | None
    ) -> NDArray[np.uint16]:
        """Return an image as stored, with dark and flat correction if the scan delivers it."""
        detector = self._detector(frame)
        stored = detector.stored(image).astype(np.float64)
        offset = dark if dark is not None else np.zeros_like(stored)
        if self.scenario.dark.correction:
            stored = stored - offset
        if self.scenario.flat.correction and flat is not None:
            base = flat - offset if self.scenario.dark.correction else flat
            stored = stored / np.where(base > 0, base, 1.0) * detector.brightest
        return detector.stored(stored)


def _claim(files: OutputPaths, identity: str, resume: bool) -> None:
    """Check that the folder is free or holds this very rendering, and write the key file."""
    # NAME_* would also match the images of NAME_2.
    own = re.compile(re.escape(files.name) + r"_([0-9]{4,}|(dark|flat)(_[0-9]{4,})?)\.tif")
    images = any(own.fullmatch(path.name) for path in files.folder.iterdir())
    # A rendering that failed before its first image claims nothing.
    claimed = files.key.exists() and (images or files.metadata.exists())
    name, other = files.name, "choose another --out"
    if claimed and not resume:
        problem = f"already holds images of {name}: {other}, or go on with --resume"
    elif claimed and _digest(files.key) != identity:
        problem = f"holds {name} rendered from other files or with other options: {other}"
    elif images and not claimed:
        problem = f"holds images of {name} from elsewhere: {other}"
    else:
        write_text(files.key, json.dumps({"digest": identity}) + "\n")
        return
    raise ScanExistsError(f"{files.folder} {problem}")


def _digest(key: Path) -> str | None:
    """Return the digest in a key file; None if the file is not ours."""
    try:
        stored = read_json(key)
    except (OSError, ValueError):
        return None
    return stored.get("digest") if isinstance(stored, dict) else None


def _identity(scenario: CtsimuScenario, options: Options) -> str:
    """Return a digest of the scenario, all files that it refers to, and the options."""
    digest = hashlib.sha256(json.dumps([scenario.data, asdict(options)]).encode())
    for path in sorted(_referred(scenario)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _referred(scenario: CtsimuScenario) -> set[Path]:
    files: set[Path | RawImage | None] = set()
    for index in range(scenario.frames):
        frame = scenario.frame(index)
        response = frame.response
        files |= {sample.file for sample in frame.samples}
        files |= {frame.tube.spectrum, frame.spot.image, response.bad_pixels}
        files |= {response.efficiency, response.curve, response.noise, response.mtf}
    return {item.path if isinstance(item, RawImage) else item for item in files if item is not None}
