"""Geometry from the numbers of other toolkits, as ``twinct export`` writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.boundary import read_text
from twinct.core.files.plain_json import json_of
from twinct.core.files.plain_xml import xml_with_doctype
from twinct.core.foreign_text import number, quoted
from twinct.core.settings import Length, Pair, Section, setting
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.measured.matrices import views_of_matrices
from twinct.measured.views import ImageFacts, StatedViews, views_of

MOST_BYTES = 2**30

Arrays = dict[str, NDArray[Any]]

UNEQUAL = 1e-3
"""Largest relative difference of the pitches of two views."""


def _arrays(path: Path, names: tuple[str, ...]) -> Arrays:
    """Return the float64 arrays of an .npz file.

    Raises:
        InputError: one of these names is missing, or a number is not finite.
    """
    where = f"{path}: geometry"
    content = read_npz(path, where, MOST_BYTES)
    if missing := [name for name in names if name not in content]:
        raise InputError(
            f"{where}: no array {', '.join(missing)}; it holds {', '.join(sorted(content))}"
        )
    arrays = {name: content[name].astype(np.float64) for name in names}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"{where}: {name} holds a number that is not finite")
    return arrays


def _made(path: Path, facts: ImageFacts, panel: Panel, *vectors: NDArray[Any]) -> StatedViews:
    """Return the views of (S, D, u, v), (views, 3), after a check of the counts."""
    where = f"{path}: geometry"
    source, detector, u, v = vectors
    facts.require(where, len(source), panel)
    geometry, flipped = views_of(where, source, detector, u, v, panel)
    note = f"{path.name}: {len(geometry)} views, panel {panel.rows} x {panel.columns} pixels of "
    note += f"{panel.pitch_u:g} x {panel.pitch_v:g} mm, mm in the frame of the file"
    return StatedViews(geometry, flip_rows=flipped, notes=(note,))


class _Numbers(Section):
    """Numbers of a toolkit in one file."""

    path: Path = Field(description=".npz file, as twinct export writes.")

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the file does not hold them, or they do not fit the images.
        """
        return _made(self.path, facts, *self._panel_and_vectors())

    def _panel_and_vectors(self) -> tuple[Panel, Floats, Floats, Floats, Floats]:
        """Return the panel and S, D, u and v of all views, (views, 3)."""
        raise NotImplementedError

    def _counts(self, result: Arrays, name: str) -> tuple[int, int]:
        """Return the two numbers of pixels in an array.

        Raises:
            InputError: they are no whole numbers above 0.
        """
        numbers = result[name]
        if numbers.shape != (2,) or (numbers < 1).any() or (numbers % 1).any():
            raise InputError(
                f"{self.path}: {name} is {quoted(numbers.tolist())}; expected two numbers of pixels"
            )
        return int(numbers[0]), int(numbers[1])


class Astra(_Numbers):
    """ASTRA's ``cone_vec``."""

    kind: Literal["astra"]

    def _panel_and_vectors(self) -> tuple[Panel, Floats, Floats, Floats, Floats]:
        arrays = _arrays(self.path, ("vectors", "detector"))
        if arrays["vectors"].ndim != 2 or arrays["vectors"].shape[1] != 12:
            raise InputError(
                f"{self.path}: vectors: shape {arrays['vectors'].shape}; expected (views, 12)"
            )
        source, detector, u, v = np.split(arrays["vectors"], 4, axis=1)
        rows, columns = self._counts(arrays, "detector")
        pitches = [np.linalg.norm(axis, axis=1) for axis in (u, v)]
        for pitch in pitches:
            if (off := np.abs(pitch - pitch[0])).max() > UNEQUAL * pitch[0]:
                view = int(off.argmax())
                raise InputError(
                    f"{self.path}: vectors: pixels of view {view} are {pitch[view]:.6g} mm apart, "
                    f"those of view 0 {pitch[0]:.6g} mm: one panel has one pitch"
                )
        return Panel(rows, columns, *(float(pitch[0]) for pitch in pitches)), source, detector, u, v


class Leap(_Numbers):
    """LEAP's modular beam."""

    kind: Literal["leap"]

    def _panel_and_vectors(self) -> tuple[Panel, Floats, Floats, Floats, Floats]:
        names = "sourcePositions", "moduleCenters", "colVectors", "rowVectors"
        arrays = _arrays(self.path, (*names, "detector", "pixel"))
        rows, columns = self._counts(arrays, "detector")
        height, width = arrays["pixel"].tolist()
        source, detector, u, v = (arrays[name] for name in names)
        return Panel(rows, columns, width, height), source, detector, u, v


class Cil(_Numbers):
    """CIL's ``Cone3D_Flex``, with the panel's origin at bottom left."""

    kind: Literal["cil"]

    def _panel_and_vectors(self) -> tuple[Panel, Floats, Floats, Floats, Floats]:
        names = "source_position_set", "detector_position_set"
        names += "detector_direction_x_set", "detector_direction_y_set"
        arrays = _arrays(self.path, (*names, "num_pixels", "pixel_size"))
        columns, rows = self._counts(arrays, "num_pixels")
        source, detector, u, v = (arrays[name] for name in names)
        return Panel(rows, columns, *arrays["pixel_size"].tolist()), source, detector, u, v


class Tigre(_Numbers):
    """TIGRE's angles and distances; ``twinct.exchange.tigre`` has the formulas."""

    kind: Literal["tigre"]

    def _panel_and_vectors(self) -> tuple[Panel, Floats, Floats, Floats, Floats]:
        names = "angles", "DSO", "DSD", "offOrigin", "offDetector", "rotDetector"
        arrays = _arrays(self.path, (*names, "nDetector", "dDetector"))
        if arrays["rotDetector"][..., 1:].any():
            raise InputError(
                f"{self.path}: rotDetector: pitch or roll is not 0; only a yaw is read"
            )
        angles = np.atleast_2d(arrays["angles"])
        views = len(angles)
        turn = Rotation.from_euler("ZYZ", angles)
        dso, dsd = (np.broadcast_to(arrays[name], (views,)) for name in ("DSO", "DSD"))
        origin = np.broadcast_to(arrays["offOrigin"], (views, 3))[:, ::-1]
        up, right = np.broadcast_to(arrays["offDetector"], (views, 2)).T
        yaw = np.broadcast_to(arrays["rotDetector"], (views, 3))[:, 0]
        nothing = np.zeros(views)
        source = turn.apply(np.stack([dso, nothing, nothing], axis=1)) - origin
        detector = source + turn.apply(np.stack([-dsd, right, up], axis=1))
        u = turn.apply(np.stack([nothing, np.cos(yaw), np.sin(yaw)], axis=1))
        v = turn.apply(np.stack([nothing, -np.sin(yaw), np.cos(yaw)], axis=1))
        rows, columns = self._counts(arrays, "nDetector")
        pitch_v, pitch_u = arrays["dDetector"].tolist()
        return Panel(rows, columns, pitch_u, pitch_v), source, detector, u, v


class Rtk(Section):
    """RTK's XML; ``twinct.exchange.rtk`` has the formulas."""

    kind: Literal["rtk"]
    path: Path = Field(description="The XML file.")
    pitch_mm: Length | Pair | None = setting(
        None, "Pixel pitch; null: the spacing in the images' MetaImage file."
    )
    first_pixel_mm: tuple[float, float] | None = setting(
        None, "Place of pixel (0, 0); null: that in the MetaImage file, or a centred panel."
    )

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the file does not hold them, or they do not fit the images.
        """
        pitch = self.pitch_mm or facts.spacing
        if pitch is None:
            raise InputError("geometry.pitch_mm: the images do not state it, nor does RTK's XML")
        panel = facts.panel(pitch)
        numbers = _rtk_numbers(self.path)
        turns = -np.stack([numbers[n] for n in ("InPlaneAngle", "OutOfPlaneAngle", "GantryAngle")])
        axes = Rotation.from_euler("ZXY", turns.T, degrees=True).as_matrix()  # rows u, v, n
        sod, sdd = (numbers[f"SourceTo{end}Distance"] for end in ("Isocenter", "Detector"))
        first = self.first_pixel_mm or facts.first_pixel or panel.first_pixel_mm
        beside = np.array(first) - panel.first_pixel_mm
        source = np.stack([numbers["SourceOffsetX"], numbers["SourceOffsetY"], sod], axis=1)
        right, up = (numbers[f"ProjectionOffset{axis}"] for axis in "XY")
        detector = np.stack([right + beside[0], up + beside[1], sod - sdd], axis=1)
        points = (np.einsum("vij,vi->vj", axes, at) for at in (source, detector))
        return _made(self.path, facts, panel, *points, axes[:, 0], axes[:, 1])


_RTK_NEEDED = ("SourceToIsocenterDistance", "SourceToDetectorDistance", "GantryAngle")
_RTK_FREE = ("SourceOffsetX", "SourceOffsetY", "ProjectionOffsetX", "ProjectionOffsetY")
_RTK_FREE += ("InPlaneAngle", "OutOfPlaneAngle")
_RTK_OTHERS = ("Matrix", "Projection", "CollimationUInf", "CollimationUSup")
_RTK_OTHERS += ("CollimationVInf", "CollimationVSup")


def _rtk_numbers(path: Path) -> dict[str, Floats]:
    """Return RTK's parameters of each view by their names, deg and mm.

    Raises:
        InputError: the file is no such XML, or a parameter is missing or not supported.
    """
    text = read_text(path, f"{path}: geometry", MOST_BYTES)
    try:
        root = xml_with_doctype(text)
    except ValueError as error:
        raise InputError(f"{path}: not an XML file of RTK: {error}") from None
    projections = root.findall("Projection")
    if root.tag != "RTKThreeDCircularGeometry" or not projections:
        raise InputError(f"{path}: not a geometry of RTK: {quoted(root.tag)} without a Projection")
    shared = {child.tag: child.text or "" for child in root if child.tag != "Projection"}
    rows: list[dict[str, float]] = []
    for view, projection in enumerate(projections):
        values = shared | {child.tag: child.text or "" for child in projection}
        known = (*_RTK_NEEDED, *_RTK_FREE, *_RTK_OTHERS)
        if missing := [name for name in _RTK_NEEDED if name not in values]:
            raise InputError(f"{path}: projection {view} has no {', '.join(missing)}")
        if other := [n for n in values if n not in known and values[n].strip() not in ("", "0")]:
            raise InputError(f"{path}: projection {view}: {', '.join(other)} is not supported")
        row = dict.fromkeys(_RTK_FREE, 0.0)
        try:
            row |= {k: number(values[k]) for k in (*_RTK_NEEDED, *_RTK_FREE) if k in values}
        except ValueError as error:
            raise InputError(f"{path}: projection {view}: {error}") from None
        rows.append(row)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


class OpenCt(Section):
    """OpenCT free trajectory: matrices in JSON."""

    kind: Literal["openct"]
    path: Path = Field(description="The JSON file.")

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the file does not hold them, or they do not fit the images.
        """
        description = read_openct(self.path)
        where = f"{self.path}: projections.matrices"
        matrices, panel = description["matrices"], description["panel"]
        facts.require(where, len(matrices), panel)
        to_pixels = np.linalg.inv(panel.mm_from_pixel)
        return views_of_matrices(where, to_pixels @ matrices, panel)


def read_openct(path: Path) -> dict[str, Any]:
    """Return ``matrices`` (views, 3, 4) to mm, ``panel``, ``files`` and ``transmission``.

    Raises:
        InputError: the file is no OpenCT free trajectory.
    """
    where = f"{path}"
    try:
        data = json_of(read_text(path, where, MOST_BYTES))
        projections, geometry = data["projections"], data["geometry"]
        frame = projections["detectorCoordinateFrame"], projections["detectorCoordinateDimension"]
        matrices = np.array(projections["matrices"], dtype=np.float64).reshape(-1, 3, 4)
        (columns, rows), (width, height) = geometry["detectorPixel"], geometry["detectorSize"]
        panel = Panel(rows, columns, width / columns, height / rows)
        images = projections["images"]
        return {
            "matrices": matrices,
            "panel": panel,
            "frame": _require_frame(where, *frame),
            "files": [path.parent / images["directory"] / name for name in images["files"]],
            "transmission": bool(projections["intensityDomain"]),
        }
    except (ValueError, KeyError, TypeError, ZeroDivisionError) as error:
        raise InputError(f"{where}: not an OpenCT free trajectory: {error!r}") from None


def _require_frame(where: str, frame: str, dimension: str) -> str:
    if frame != "OriginAtDetectorCenter.VerticalAxisRunningDownwards" or dimension != "Length":
        raise InputError(f"{where}: detector coordinates {frame}, {dimension} are not supported")
    return frame


class Ctsimu(Section):
    """CTSimU scenario: the geometry that the reconstruction knows, in the stage's frame."""

    kind: Literal["ctsimu"]
    path: Path = Field(description="The JSON file.")

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the file does not hold them, or they do not fit the images.
        """
        from twinct.ctsimu.scenario import known_geometry

        geometry: ScanGeometry = known_geometry(self.path)
        facts.require(f"{self.path}", len(geometry), geometry.panel)
        note = f"{self.path.name}: {len(geometry)} views of a CTSimU scenario, as known, mm"
        return StatedViews(geometry, flip_rows=True, notes=(note,))
