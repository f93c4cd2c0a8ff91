"""Where source and panel are in each view of a scan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twinct.geometry.arrays import UNIT_TOLERANCE, Floats, frozen
from twinct.geometry.panel import Panel
from twinct.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class ScanGeometry:
    """Where source and panel are in each view.

    Attributes:
        source: focal spots S, (views, 3), mm.
        detector: panel centres D, (views, 3), mm.
        u: unit vectors along +column, (views, 3).
        v: unit vectors along +row, (views, 3), orthogonal to u, u x v towards the source.
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
        for name in ("source", "detector", "u", "v"):
            object.__setattr__(self, name, frozen(getattr(self, name), (views, 3), name))
        for name in ("u", "v"):
            bad = np.abs(np.linalg.norm(getattr(self, name), axis=1) - 1.0) > UNIT_TOLERANCE
            if bad.any():
                raise ValueError(f"{name} of view {int(bad.argmax())} is not a unit vector")
        bad = np.abs(np.einsum("ij,ij->i", self.u, self.v)) > UNIT_TOLERANCE
        if bad.any():
            raise ValueError(f"u and v of view {int(bad.argmax())} are not orthogonal")
        bad = np.einsum("ij,ij->i", self.normal, self.source - self.detector) <= 0
        if bad.any():
            raise ValueError(
                f"u x v of view {int(bad.argmax())} points away from the source: "
                "the panel would be seen from behind"
            )

    @classmethod
    def from_poses(
        cls, sources: Iterable[Pose], detectors: Iterable[Pose], panel: Panel
    ) -> ScanGeometry:
        """Build from ``world_from_source`` and ``world_from_detector`` of each view."""
        sources, detectors = list(sources), list(detectors)
        rotations = [pose.rotation for pose in detectors]
        return cls(
            np.array([pose.position for pose in sources]),
            np.array([pose.position for pose in detectors]),
            np.array([rotation[:, 0] for rotation in rotations]),
            np.array([rotation[:, 1] for rotation in rotations]),
            panel,
        )

    @property
    def normal(self) -> Floats:
        """Unit normals u x v of the panel, towards the source, (views, 3)."""
        return np.cross(self.u, self.v)

    def source_poses(self) -> list[Pose]:
        """``world_from_source`` of each view: z towards the panel centre, x the nearest to u."""
        return [
            _source_pose(s, d, u)
            for s, d, u in zip(self.source, self.detector, self.u, strict=True)
        ]

    def detector_poses(self) -> list[Pose]:
        """``world_from_detector`` of each view: axes (u, v, u x v)."""
        return [
            Pose.from_matrix(d, np.stack([u, v, n], axis=1))
            for d, u, v, n in zip(self.detector, self.u, self.v, self.normal, strict=True)
        ]

    def __len__(self) -> int:
        """Number of views."""
        return len(self.source)

    def __getitem__(self, views: Any) -> ScanGeometry:
        """The geometry of a slice, a list of indices, a mask, or one view."""
        if isinstance(views, (int, np.integer)):
            views = [views]
        return ScanGeometry(
            self.source[views], self.detector[views], self.u[views], self.v[views], self.panel
        )

    def __iter__(self) -> Iterator[ScanGeometry]:
        """One geometry of one view after the other."""
        return (self[i] for i in range(len(self)))

    def __eq__(self, other: object) -> bool:
        """Same numbers, to the last bit."""
        return (
            isinstance(other, ScanGeometry)
            and self.panel == other.panel
            and all(
                np.array_equal(getattr(self, n), getattr(other, n))
                for n in ("source", "detector", "u", "v")
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def __rmatmul__(self, outer_from_inner: Pose) -> ScanGeometry:
        """``object_from_world @ geometry``: the same views in another frame."""
        return self.transformed(outer_from_inner)

    def transformed(self, outer_from_inner: Pose) -> ScanGeometry:
        """The same views, seen from another frame."""
        return ScanGeometry(
            outer_from_inner.apply(self.source),
            outer_from_inner.apply(self.detector),
            outer_from_inner.rotate(self.u),
            outer_from_inner.rotate(self.v),
            self.panel,
        )

    def project(self, points: ArrayLike) -> Floats:
        """Pixel coordinates of points.

        Args:
            points: (points, 3), mm.

        Returns:
            (views, points, 2): fractional (column, row); pixel centres are whole numbers. NaN where
            a point lies in or behind the plane through the source parallel to the panel.
        """
        rays = np.atleast_2d(np.asarray(points, dtype=np.float64))[None] - self.source[:, None]
        to_panel = self.detector - self.source
        depth = np.einsum("vpk,vk->vp", rays, self.normal)
        reach = np.einsum("vk,vk->v", to_panel, self.normal)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(depth * reach > 0, reach / depth, np.nan)
        offset = scale[..., None] * rays - to_panel[:, None]
        column = np.einsum("vpk,vk->vp", offset, self.u) / self.panel.pitch_u
        row = np.einsum("vpk,vk->vp", offset, self.v) / self.panel.pitch_v
        centre = np.array([(self.panel.columns - 1) / 2, (self.panel.rows - 1) / 2])
        return np.stack([column, row], axis=-1) + centre

    def pixel_centres(self, view: int) -> Floats:
        """Pixel centres of one view, (rows, columns, 3), mm."""
        panel = self.panel
        along_u = (np.arange(panel.columns) - (panel.columns - 1) / 2) * panel.pitch_u
        along_v = (np.arange(panel.rows) - (panel.rows - 1) / 2) * panel.pitch_v
        return (
            self.detector[view]
            + along_u[None, :, None] * self.u[view]
            + along_v[:, None, None] * self.v[view]
        )

    def to_astra(self) -> dict[str, Any]:
        """ASTRA's ``cone_vec``, as a plain dict: (S, D, pitch_u u, pitch_v v) per row."""
        vectors = np.hstack(
            [self.source, self.detector, self.panel.pitch_u * self.u, self.panel.pitch_v * self.v]
        )
        return {
            "type": "cone_vec",
            "DetectorRowCount": self.panel.rows,
            "DetectorColCount": self.panel.columns,
            "Vectors": vectors,
        }

    def to_rtk(self) -> dict[str, Any]:
        """What RTK's ``AddProjection(S, D, row, column)`` and its projection image need.

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
            "origin": (
                -(panel.columns - 1) / 2 * panel.pitch_u,
                -(panel.rows - 1) / 2 * panel.pitch_v,
            ),
            "spacing": (panel.pitch_u, panel.pitch_v),
        }

    def __repr__(self) -> str:
        """Evaluates to an equal geometry."""
        vectors = ", ".join(
            f"{name}={getattr(self, name).tolist()}" for name in ("source", "detector", "u", "v")
        )
        return f"ScanGeometry({vectors}, panel={self.panel!r})"


def _source_pose(source: Floats, detector: Floats, u: Floats) -> Pose:
    z = (detector - source) / np.linalg.norm(detector - source)
    x = u - (u @ z) * z
    x /= np.linalg.norm(x)
    return Pose.from_matrix(source, np.stack([x, np.cross(z, x), z], axis=1))
