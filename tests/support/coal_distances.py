"""Distances between the geoms of a MuJoCo model, by a library that shares no code with MuJoCo's.

Coal (https://github.com/coal-library/coal) measures between shapes built anew from the model's
sizes and vertices. Of MuJoCo, only the places of the geoms are taken (``mj_kinematics``). Meshes
are their convex hulls, as in MuJoCo's own collisions.
"""

from __future__ import annotations

from typing import Any

import coal
import mujoco
import numpy as np
from numpy.typing import NDArray

COAL_M = 1e-5
"""Bound on the difference between both libraries' distances of separated shapes, m.

Each ends its search within about 1e-6 m of the distance. The largest difference was 2.9e-6 m among
58,000 pairs: of the built-in arms in random configurations, and of random shapes as in
``tests/cell/test_coal_distances.py``.
"""


class CoalDistances:
    """Distances in one model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Build the shapes of all geoms that can collide."""
        self._model = model
        self._shapes: dict[int, Any] = {}
        self._radii: dict[int, float] = {}
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def between(self, data: mujoco.MjData, a: int, b: int) -> float:
        """Return the distance of two geoms, m; negative or zero if they overlap.

        Args:
            data: an instant, after ``mj_kinematics``.
            a: a geom.
            b: another one.
        """
        self._result.clear()
        first, second = self._placed(data, a), self._placed(data, b)
        return float(coal.distance(*first, *second, self._request, self._result))

    def smallest(self, data: mujoco.MjData, pairs: NDArray[np.integer[Any]]) -> float:
        """Return the smallest distance of pairs of geoms, (p, 2), m."""
        bounds, found = self._bounds(data, pairs), np.inf
        for k in np.argsort(bounds, kind="stable"):
            if bounds[k] >= found:
                break
            found = min(found, self.between(data, int(pairs[k, 0]), int(pairs[k, 1])))
        return float(found)

    def clear(self, data: mujoco.MjData, pairs: NDArray[np.integer[Any]], least_m: float) -> bool:
        """Return True if all pairs of geoms, (p, 2), are at least so far apart, m."""
        near = pairs[self._bounds(data, pairs) < least_m].tolist()
        return all(self.between(data, a, b) >= least_m for a, b in near)

    def _bounds(self, data: mujoco.MjData, pairs: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return lower bounds of distances, m, from spheres about the shapes."""
        for geom in {int(geom) for geom in np.unique(pairs)} - self._radii.keys():
            self._shapes[geom] = shape_of(self._model, geom)
            self._shapes[geom].computeLocalAABB()
            box = self._shapes[geom].aabb_local
            corner = np.maximum(np.abs(box.min_), np.abs(box.max_))
            self._radii[geom] = float(np.linalg.norm(corner))
        radii = np.array([self._radii[geom] for geom in pairs.ravel().tolist()]).reshape(-1, 2)
        apart = data.geom_xpos[pairs[:, 0]] - data.geom_xpos[pairs[:, 1]]
        return np.linalg.norm(apart, axis=1) - radii.sum(axis=1)

    def _placed(self, data: mujoco.MjData, geom: int) -> tuple[Any, Any]:
        if geom not in self._shapes:
            self._shapes[geom] = shape_of(self._model, geom)
        turned = np.array(data.geom_xmat[geom]).reshape(3, 3)
        return self._shapes[geom], coal.Transform3s(turned, np.array(data.geom_xpos[geom]))


def shape_of(model: mujoco.MjModel, geom: int) -> Any:
    """Return the shape of a geom, in the geom's axes.

    Raises:
        ValueError: shapes of this kind are not known here.
    """
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom].tolist()
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_BOX:
        return coal.Box(*(2 * half for half in size))
    if kind == shapes.mjGEOM_SPHERE:
        return coal.Sphere(size[0])
    if kind == shapes.mjGEOM_ELLIPSOID:
        return coal.Ellipsoid(*size)
    if kind == shapes.mjGEOM_CAPSULE:  # both state the half or whole length of the straight part
        return coal.Capsule(size[0], 2 * size[1])
    if kind == shapes.mjGEOM_CYLINDER:
        return coal.Cylinder(size[0], 2 * size[1])
    if kind == shapes.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        corners = coal.StdVec_Vec3s()
        corners.extend(model.mesh_vert[first : first + count].astype(np.float64))
        return coal.Convex.convexHull(corners, True, "Qt")
    raise ValueError(f"no shape for a geom of kind {kind.name}")
