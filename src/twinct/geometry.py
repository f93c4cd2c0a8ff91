"""Poses, scan geometries and voxel grids: the only vocabulary in which modules speak of space.

Points are (x, y, z) in mm, right-handed, world origin at the isocentre, z up. A view is four
vectors: source S, panel centre D, and the unit vectors u (along +column) and v (along +row) with
u x v pointing to the source. Pixel (r, c) has its centre at

    D + (c - (columns - 1) / 2) pitch_u u + (r - (rows - 1) / 2) pitch_v v.

Frames: the detector frame has axes (u, v, u x v); the source frame has z towards the panel centre
and its x the nearest to u. Only ``to_*`` and ``from_*`` may reorder axes or change units.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

MM_PER_M = 1000.0
UNIT_TOLERANCE = 1e-6
"""Largest departure of u and v from unit length and right angle: float32 input still passes."""


def _frozen(values: ArrayLike, shape: tuple[int, ...], name: str) -> Floats:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a value that is not finite")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform, written ``world_from_tool``: it maps tool coordinates to world ones.

    Attributes:
        position: origin of the inner frame in the outer one, (3,), mm.
        quat: unit quaternion (x, y, z, w), (4,).
    """

    position: Floats
    quat: Floats

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        quat = _frozen(self.quat, (4,), "quat")
        if abs(np.linalg.norm(quat) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"quat {quat} is not a unit quaternion")
        object.__setattr__(self, "position", _frozen(self.position, (3,), "position"))
        object.__setattr__(self, "quat", quat)

    @classmethod
    def identity(cls) -> Pose:
        """Outer and inner frame coincide."""
        return cls(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    @classmethod
    def from_matrix(cls, position: ArrayLike, rotation: ArrayLike) -> Pose:
        """Build from an origin (3,) in mm and a rotation matrix (3, 3), columns the inner axes."""
        return cls(np.asarray(position), Rotation.from_matrix(np.asarray(rotation)).as_quat())

    @classmethod
    def from_euler(cls, position: ArrayLike, degrees: ArrayLike) -> Pose:
        """Build from an origin in mm and extrinsic x, y, z rotations in degrees."""
        return cls(
            np.asarray(position), Rotation.from_euler("xyz", degrees, degrees=True).as_quat()
        )

    @classmethod
    def from_metres(cls, position_m: ArrayLike, quat: ArrayLike) -> Pose:
        """Build from what MuJoCo and ROS 2 speak: metres, and a quaternion (x, y, z, w)."""
        return cls(np.asarray(position_m, dtype=np.float64) * MM_PER_M, np.asarray(quat))

    def to_metres(self) -> tuple[Floats, Floats]:
        """Position in metres and quaternion (x, y, z, w)."""
        return self.position / MM_PER_M, self.quat

    @property
    def rotation(self) -> Floats:
        """Rotation matrix (3, 3); its columns are the inner axes in the outer frame."""
        return Rotation.from_quat(self.quat).as_matrix()

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix (4, 4), mm."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.position
        return matrix

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: ``world_from_tool @ tool_from_source`` is ``world_from_source``."""
        if not isinstance(other, Pose):
            return NotImplemented
        return Pose(
            self.apply(other.position),
            (Rotation.from_quat(self.quat) * Rotation.from_quat(other.quat)).as_quat(),
        )

    def inverse(self) -> Pose:
        """The transform back."""
        back = Rotation.from_quat(self.quat).inv()
        return Pose(-back.apply(self.position.copy()), back.as_quat())

    def apply(self, points: ArrayLike) -> Floats:
        """Map points (..., 3) from the inner to the outer frame."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.position

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Turn vectors (..., 3) from the inner to the outer frame."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T

    def angle_deg(self, other: Pose) -> float:
        """Angle of the relative rotation, degrees."""
        relative = Rotation.from_quat(self.quat).inv() * Rotation.from_quat(other.quat)
        return float(np.degrees(relative.magnitude()))

    def distance_mm(self, other: Pose) -> float:
        """Distance of the two origins, mm."""
        return float(np.linalg.norm(self.position - other.position))

    def __eq__(self, other: object) -> bool:
        """Same numbers, to the last bit."""
        return (
            isinstance(other, Pose)
            and np.array_equal(self.position, other.position)
            and np.array_equal(self.quat, other.quat)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Evaluates to an equal pose."""
        return f"Pose({self.position.tolist()}, {self.quat.tolist()})"


@dataclass(frozen=True)
class Panel:
    """The pixel lattice of a flat panel.

    Attributes:
        rows: pixels along v.
        columns: pixels along u.
        pitch_u: pixel pitch along u, mm.
        pitch_v: pixel pitch along v, mm.
    """

    rows: int
    columns: int
    pitch_u: float
    pitch_v: float

    def __post_init__(self) -> None:
        """Refuse a panel without pixels."""
        if self.rows < 1 or self.columns < 1 or not (self.pitch_u > 0 and self.pitch_v > 0):
            raise ValueError(f"{self} has no pixels")

    @property
    def shape(self) -> tuple[int, int]:
        """Image shape (rows, columns)."""
        return self.rows, self.columns

    @property
    def size_mm(self) -> tuple[float, float]:
        """Active width along u and height along v, mm."""
        return self.columns * self.pitch_u, self.rows * self.pitch_v


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
            object.__setattr__(self, name, _frozen(getattr(self, name), (views, 3), name))
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


@dataclass(frozen=True, eq=False)
class VolumeGrid:
    """A voxel lattice centred on the origin of its own frame.

    Arrays on it have shape ``shape`` = (nz, ny, nx). Voxel (k, j, i) has its centre at
    ``world_from_grid`` applied to ((i, j, k) - (n - 1) / 2) * voxel.

    Attributes:
        shape: voxels along (z, y, x).
        voxel: voxel edges along (x, y, z), mm.
        world_from_grid: pose of the lattice.
    """

    shape: tuple[int, int, int]
    voxel: Floats
    world_from_grid: Pose

    def __init__(
        self,
        shape: Sequence[int],
        voxel: float | ArrayLike,
        world_from_grid: Pose | None = None,
    ) -> None:
        """Take one voxel edge for a cubic voxel, or three (x, y, z).

        Raises:
            ValueError: no voxels, or an edge that is not positive.
        """
        shape = tuple(int(n) for n in shape)
        edges = _frozen(np.broadcast_to(np.asarray(voxel, dtype=np.float64), (3,)), (3,), "voxel")
        if len(shape) != 3 or min(shape) < 1 or (edges <= 0).any():
            raise ValueError(f"a grid of {shape} voxels of {edges} mm holds nothing")
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "voxel", edges)
        object.__setattr__(self, "world_from_grid", world_from_grid or Pose.identity())

    @property
    def shape_xyz(self) -> tuple[int, int, int]:
        """Voxels along (x, y, z)."""
        return self.shape[2], self.shape[1], self.shape[0]

    @property
    def size_mm(self) -> Floats:
        """Edges of the whole grid along (x, y, z), mm."""
        return np.array(self.shape_xyz) * self.voxel

    def axes(self) -> tuple[Floats, Floats, Floats]:
        """Voxel centres along x, y and z of the grid's own frame, mm."""
        x, y, z = (
            (np.arange(n) - (n - 1) / 2) * edge
            for n, edge in zip(self.shape_xyz, self.voxel, strict=True)
        )
        return x, y, z

    @property
    def affine(self) -> Floats:
        """(4, 4): voxel index (i, j, k) along (x, y, z) to world mm, as in NIfTI."""
        local = np.eye(4)
        local[:3, :3] = np.diag(self.voxel)
        local[:3, 3] = -(np.array(self.shape_xyz) - 1) / 2 * self.voxel
        return self.world_from_grid.matrix @ local

    def __eq__(self, other: object) -> bool:
        """Same lattice, to the last bit."""
        return (
            isinstance(other, VolumeGrid)
            and self.shape == other.shape
            and np.array_equal(self.voxel, other.voxel)
            and self.world_from_grid == other.world_from_grid
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Evaluates to an equal grid."""
        return f"VolumeGrid({self.shape}, {self.voxel.tolist()}, {self.world_from_grid!r})"
