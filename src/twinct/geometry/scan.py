"""Scan geometry: source and panel in each view."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twinct.geometry.arrays import UNIT_TOLERANCE, Floats, frozen
from twinct.geometry.panel import Panel
from twinct.geometry.pose import Pose

_VECTORS = ("source", "detector", "u", "v")

FARTHEST_MM = 1e9
"""Largest coordinate in the world; the squares of much larger numbers overflow."""


@dataclass(frozen=True, eq=False)
class ScanGeometry:
    """Source positions and panel poses of all views.

    Attributes:
        source: focal spots S, (views, 3), mm.
        detector: panel centres D, (views, 3), mm.
        u: unit vectors along +column, (views, 3).
        v: unit vectors along +row, (views, 3), orthogonal to u, with u x v towards the source.
        panel: the pixel lattice.
    """

    source: Floats
    detector: Floats
    u: Floats
    v: Floats
    panel: Panel

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        views = len(np.atleast_2d(np.asarray(self.source)))
        for name in _VECTORS:
            object.__setattr__(self, name, frozen(getattr(self, name), (views, 3), name))
        length_u, length_v = (np.linalg.norm(axis, axis=1) for axis in (self.u, self.v))
        far = f"is farther than {FARTHEST_MM:g} mm from the origin of the world"
        behind = "points away from the source: the panel would be seen from behind"
        for what, bad, problem in (
            ("source", (np.abs(self.source) > FARTHEST_MM).any(axis=1), far),
            ("detector", (np.abs(self.detector) > FARTHEST_MM).any(axis=1), far),
            ("u", np.abs(length_u - 1.0) > UNIT_TOLERANCE, "is not a unit vector"),
            ("v", np.abs(length_v - 1.0) > UNIT_TOLERANCE, "is not a unit vector"),
            ("u and v", np.abs(_dot(self.u, self.v)) > UNIT_TOLERANCE, "are not orthogonal"),
            ("u x v", _dot(self.normal, self.source - self.detector) <= 0, behind),
        ):
            if bad.any():
                raise ValueError(f"{what} of view {int(bad.argmax())} {problem}")

    @classmethod
    def from_poses(
        cls, sources: Iterable[Pose], detectors: Iterable[Pose], panel: Panel
    ) -> ScanGeometry:
        """Build from ``world_from_source`` and ``world_from_detector`` of each view."""
        detectors = list(detectors)
        rotations = np.array([pose.rotation for pose in detectors])
        centres = np.array([pose.position for pose in detectors])
        spots = np.array([pose.position for pose in sources])
        return cls(spots, centres, rotations[:, :, 0], rotations[:, :, 1], panel)

    @classmethod
    def joined(cls, parts: Sequence[ScanGeometry]) -> ScanGeometry:
        """Concatenate the views of several geometries with the same panel."""
        source, detector, u, v = (
            np.concatenate([getattr(part, name) for part in parts]) for name in _VECTORS
        )
        return cls(source, detector, u, v, parts[0].panel)

    @property
    def normal(self) -> Floats:
        """Unit normals u x v of the panel, towards the source, (views, 3)."""
        return np.cross(self.u, self.v)

    @property
    def sdd(self) -> Floats:
        """Source-detector distance along the panel's normal, (views,), mm."""
        return self.depth(self.detector)

    @property
    def sdd_to_centre(self) -> Floats:
        """Distance from the source to the panel's centre, (views,), mm; at least ``sdd``."""
        return np.linalg.norm(self.source - self.detector, axis=1)

    def depth(self, points: ArrayLike) -> Floats:
        """Return the depth of points in front of the source, along the panel's normal.

        Args:
            points: (3,) or (views, 3), mm.

        Returns:
            (views,), mm; negative behind the plane through the source parallel to the panel.
        """
        return _dot(self.source - np.asarray(points), self.normal)

    @property
    def piercing_points(self) -> Floats:
        """Piercing points (column, row) of the perpendiculars from source to panel, (views, 2)."""
        to_panel = self.detector - self.source
        (column, row), panel = self.panel.middle, self.panel
        across, up = _dot(to_panel, self.u) / panel.pitch_u, _dot(to_panel, self.v) / panel.pitch_v
        return np.stack([column - across, row - up], axis=1)

    def matrices(self, origin: ArrayLike = (0, 0, 0), step: ArrayLike = (1, 1, 1)) -> Floats:
        """Return the projection matrix of each view, (views, 3, 4).

        It maps (i, j, k, 1) to (column w, row w, w), where w is the ``depth`` in mm of the point
        ``origin`` + ``step`` (i, j, k). By default (i, j, k) are coordinates in mm.

        Args:
            origin: position of (0, 0, 0), (3,), mm.
            step: distance per index along x, y and z, (3,), mm.
        """
        origin, step = np.asarray(origin, np.float64), np.asarray(step, np.float64)
        ahead, reach = -self.normal, self.sdd[:, None]

        def along(axis: Floats, pitch: float, start: Floats) -> Floats:
            return reach / pitch * axis + start[:, None] * ahead

        columns, rows = self.piercing_points.T
        u, v = along(self.u, self.panel.pitch_u, columns), along(self.v, self.panel.pitch_v, rows)
        linear = np.stack([u, v, ahead], axis=1)
        constant = np.einsum("vij,vj->vi", linear, origin - self.source)
        return np.concatenate([linear * step, constant[:, :, None]], axis=2)

    def source_poses(self) -> list[Pose]:
        """Return ``world_from_source`` of each view: z towards the panel centre, x nearest to u."""
        return list(map(_source_pose, self.source, self.detector, self.u))

    def detector_poses(self) -> list[Pose]:
        """Return ``world_from_detector`` of each view: axes (u, v, u x v)."""
        return [
            Pose.from_matrix(d, np.stack([u, v, n], axis=1))
            for d, u, v, n in zip(self.detector, self.u, self.v, self.normal, strict=True)
        ]

    def source_matrices(self) -> Floats:
        """Return the matrices of ``source_poses``, (views, 4, 4), mm."""
        z: Floats = self.detector - self.source
        z /= np.linalg.norm(z, axis=1, keepdims=True)
        x: Floats = self.u - _dot(self.u, z)[:, None] * z
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        y = np.asarray(np.cross(z, x), np.float64)
        return _matrices(self.source, x, y, z)

    def detector_matrices(self) -> Floats:
        """Return the matrices of ``detector_poses``, (views, 4, 4), mm."""
        return _matrices(self.detector, self.u, self.v, self.normal)

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.source)

    def __getitem__(self, views: Any) -> ScanGeometry:
        """Return the geometry of a slice, a list of indices, a mask, or one view."""
        if isinstance(views, (int, np.integer)):
            views = [views]
        return ScanGeometry(
            self.source[views], self.detector[views], self.u[views], self.v[views], self.panel
        )

    def __iter__(self) -> Iterator[ScanGeometry]:
        """Iterate over the views, each as a geometry of one view."""
        return (self[i] for i in range(len(self)))

    def __eq__(self, other: object) -> bool:
        """Compare two geometries, to the last bit."""
        if not isinstance(other, ScanGeometry) or self.panel != other.panel:
            return False
        return all(np.array_equal(getattr(self, n), getattr(other, n)) for n in _VECTORS)

    __hash__ = None  # type: ignore[assignment]

    def __rmatmul__(self, outer_from_inner: Pose) -> ScanGeometry:
        """Return the same views in another frame: ``object_from_world @ geometry``."""
        source, detector = map(outer_from_inner.apply, (self.source, self.detector))
        u, v = map(outer_from_inner.rotate, (self.u, self.v))
        return ScanGeometry(source, detector, u, v, self.panel)

    def project(self, points: ArrayLike) -> Floats:
        """Return the pixel coordinates of points.

        Args:
            points: (points, 3), mm.

        Returns:
            (views, points, 2): fractional (column, row); pixel centres are whole numbers. NaN where
            a point lies in or behind the plane through the source parallel to the panel.
        """
        rays = np.atleast_2d(np.asarray(points, dtype=np.float64))[None] - self.source[:, None]
        to_panel = self.detector - self.source
        depth = np.einsum("vpk,vk->vp", rays, self.normal)
        reach = -self.sdd[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(depth * reach > 0, reach / depth, np.nan)
        offset = scale[..., None] * rays - to_panel[:, None]
        column = np.einsum("vpk,vk->vp", offset, self.u) / self.panel.pitch_u
        row = np.einsum("vpk,vk->vp", offset, self.v) / self.panel.pitch_v
        return np.stack([column, row], axis=-1) + self.panel.middle

    def pixel_centres(self, view: int) -> Floats:
        """Return the pixel centres of one view, (rows, columns, 3), mm."""
        panel = self.panel
        along_u = (np.arange(panel.columns) - panel.middle[0]) * panel.pitch_u
        along_v = (np.arange(panel.rows) - panel.middle[1]) * panel.pitch_v
        across, up = along_u[None, :, None] * self.u[view], along_v[:, None, None] * self.v[view]
        return self.detector[view] + across + up

    def to_astra(self) -> dict[str, Any]:
        """Return ASTRA's ``cone_vec`` as a plain dict: (S, D, pitch_u u, pitch_v v) per row."""
        panel = self.panel
        steps = panel.pitch_u * self.u, panel.pitch_v * self.v
        return {
            "type": "cone_vec",
            "DetectorRowCount": panel.rows,
            "DetectorColCount": panel.columns,
            "Vectors": np.hstack([self.source, self.detector, *steps]),
        }

    def to_rtk(self) -> dict[str, Any]:
        """Return the inputs of RTK's ``AddProjection(S, D, row, column)`` and projection image.

        Returns:
            ``source``, ``detector``, ``row`` (= u), ``column`` (= v), each (views, 3); ``origin``
            and ``spacing`` (2,) of the projection image along (u, v), mm.
        """
        panel = self.panel
        return {
            "source": self.source,
            "detector": self.detector,
            "row": self.u,
            "column": self.v,
            "origin": panel.first_pixel_mm,
            "spacing": (panel.pitch_u, panel.pitch_v),
        }

    def binned(self, rows: int, columns: int) -> ScanGeometry:
        """Return the same views with binned pixels, as in ``Panel.binned``."""
        panel, binned = self.panel, self.panel.binned(rows, columns)
        left_u = (panel.columns - binned.columns * columns) * panel.pitch_u
        left_v = (panel.rows - binned.rows * rows) * panel.pitch_v
        centre = self.detector - left_u / 2 * self.u - left_v / 2 * self.v
        return replace(self, detector=centre, panel=binned)

    def __repr__(self) -> str:
        """Return an expression that evaluates to an equal geometry."""
        vectors = ", ".join(f"{name}={getattr(self, name).tolist()}" for name in _VECTORS)
        return f"ScanGeometry({vectors}, panel={self.panel!r})"


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the dot product of each view, (views,)."""
    return np.einsum("vk,vk->v", a, b)


def _matrices(position: Floats, *axes: Floats) -> Floats:
    """Return homogeneous matrices from origins and axes, each (views, 3)."""
    matrices = np.tile(np.eye(4), (len(position), 1, 1))
    matrices[:, :3, :3] = np.stack(axes, axis=2)
    matrices[:, :3, 3] = position
    return matrices


def _source_pose(source: Floats, detector: Floats, u: Floats) -> Pose:
    z = (detector - source) / np.linalg.norm(detector - source)
    x = u - (u @ z) * z
    x /= np.linalg.norm(x)
    return Pose.from_matrix(source, np.stack([x, np.cross(z, x), z], axis=1))
