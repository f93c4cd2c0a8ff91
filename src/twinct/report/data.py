"""Contents of a report: small enough to pass on, without any whole volume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.evaluation.figure import REFERENCE
from twinct.geometry import Floats, Panel, VolumeGrid
from twinct.geometry.wire import PosePairs
from twinct.report.style import Picture
from twinct.scenario.imported import ScanSettings


class CrossSection(NamedTuple):
    """One plane of voxels, with axis 0 upwards and axis 1 to the right.

    Attributes:
        reconstruction: attenuation, (up, right), 1/mm.
        truth: true attenuation, (up, right), 1/mm; None if it is not known.
        roi: voxels that every view sees, (up, right), bool.
        extent_mm: outer edges (left, right, bottom, top), mm.
        axes: names of the axes (right, up).
        position: position of the plane, such as "z = 0.2 mm".
    """

    reconstruction: NDArray[np.floating]
    truth: NDArray[np.floating] | None
    roi: NDArray[np.bool_]
    extent_mm: tuple[float, float, float, float]
    axes: tuple[str, str] = ("", "")
    position: str = ""

    @property
    def known_truth(self) -> NDArray[np.floating]:
        """True attenuation of a section that has it."""
        assert self.truth is not None
        return self.truth

    @property
    def error(self) -> NDArray[np.float64]:
        """Reconstruction less truth, 1/mm."""
        return self.reconstruction.astype(np.float64) - self.known_truth


@dataclass(frozen=True, eq=False)
class Another:
    """Another reconstruction of the same scan.

    Attributes:
        name: name of the reconstruction.
        in_words: algorithm, settings and geometry in one line.
        figures: its figures by name, as ``metrics.json`` has them.
        residuals: residual of each iteration.
        slices: cross-sections by name.
        seconds: duration of the reconstruction.
    """

    name: str
    in_words: str
    figures: Mapping[str, Any]
    residuals: Sequence[float]
    slices: Mapping[str, CrossSection]
    seconds: float | None = None


@dataclass(frozen=True, eq=False)
class ReportData:
    """Everything a report shows; what does not exist of a scan is left out.

    Attributes:
        scenario: scenario of the scan, or what is known of it.
        scenario_yaml: the same as text.
        metrics: result of ``build_metrics``; figures of a run need a truth.
        stated: poses of an imported scan.
        commanded: poses of the trajectory.
        executed: poses at exposure, of the same views.
        clearance_mm: smallest gap during the move to each view, (views,), mm.
        projections: a few views, (view, transmission (row, col)).
        slices: cross-sections by name, see ``cross_sections``.
        mu_reference: attenuation to which figures are relative, 1/mm; the largest true value if
            None.
        reference: name of the material with this attenuation.
        room_png: picture of the robot cell, or None.
        others: further reconstructions.
        predictions: predicted views in words, and their picture.
        mas: tube load of each view, (views,), mAs; None: the scenario's for all.
        motion: the patient's motion in words; empty if nothing moves.
        nearest: the two bodies that come closest to each other in the plan; empty if unknown.
    """

    scenario: ScanSettings
    scenario_yaml: str
    metrics: Mapping[str, Any]
    panel: Panel
    commanded: PosePairs | None = None
    executed: PosePairs | None = None
    clearance_mm: Floats | None = None
    stated: PosePairs | None = None
    projections: Sequence[tuple[int, NDArray[np.floating]]] = ()
    slices: Mapping[str, CrossSection] = field(default_factory=dict)
    mu_reference: float | None = None
    reference: str = REFERENCE
    room_png: bytes | None = None
    nearest: tuple[str, ...] = ()
    others: Sequence[Another] = ()
    predictions: Sequence[tuple[str, Picture]] = ()
    mas: Floats | None = None
    motion: str = ""


PLANES = {"axial": 0, "coronal": 1, "sagittal": 2}
"""Array axis orthogonal to each plane."""


def cross_sections(
    volume: ArrayLike, truth: ArrayLike | None, roi: ArrayLike, grid: VolumeGrid
) -> dict[str, CrossSection]:
    """Return the axial, coronal and sagittal planes through the middle of the grid.

    If such a plane misses the specimen, the plane through the middle of its bounds is used.
    Coordinates are the world's, or the grid's own if the grid is rotated.

    Args:
        volume: reconstructed attenuation, (z, y, x), 1/mm.
        truth: true attenuation, (z, y, x), 1/mm; None if it is not known.
        roi: region that every view sees, (z, y, x), bool.
        grid: the lattice of all three.
    """
    known = None if truth is None else np.asarray(truth)
    volume, roi = np.asarray(volume), np.asarray(roi)
    turned = not np.allclose(grid.world_from_grid.rotation, np.eye(3), atol=1e-12)
    shift = np.zeros(3) if turned else grid.world_from_grid.position
    centres = [axis + offset for axis, offset in zip(grid.axes(), shift, strict=True)][::-1]
    edges = grid.voxel[::-1]
    names = [f"{'grid ' if turned else ''}{name}" for name in "zyx"]
    sections = {}
    for name, normal in PLANES.items():
        index = volume.shape[normal] // 2 if known is None else _plane(known, normal)
        up, right = (axis for axis in range(3) if axis != normal)
        left, right_edge, bottom, top = (
            float(centres[axis][end] + side * edges[axis] / 2)
            for axis in (right, up)
            for end, side in ((0, -1), (-1, 1))
        )
        values, seen = (np.take(array, index, axis=normal).copy() for array in (volume, roi))
        true = None if known is None else np.take(known, index, axis=normal).copy()
        extent, axes = (left, right_edge, bottom, top), (names[right], names[up])
        where = f"{names[normal]} = {centres[normal][index]:.1f} mm"
        sections[name] = CrossSection(values, true, seen.astype(np.bool_), extent, axes, where)
    return sections


def _plane(truth: NDArray[np.floating], normal: int) -> int:
    middle = truth.shape[normal] // 2
    if np.any(np.take(truth, middle, axis=normal)):
        return middle
    others = tuple(axis for axis in range(3) if axis != normal)
    hits = np.flatnonzero(np.any(truth, axis=others))
    return int(hits[0] + hits[-1]) // 2 if hits.size else middle
