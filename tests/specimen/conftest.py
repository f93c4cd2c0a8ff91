"""What several tests of specimens need."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture
def inside():
    """Whether points lie inside a closed mesh, by its winding number (Van Oosterom, Strackee)."""

    def winding(mesh, points):
        corners = mesh.triangles[None] - np.asarray(points, dtype=float)[:, None, None]
        a, b, c = (corners[:, :, i] for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))

        def dot(p, q):
            return np.einsum("ijk,ijk->ij", p, q)

        above = dot(a, np.cross(b, c))
        below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
        return np.arctan2(above, below).sum(axis=1) / (2 * np.pi) > 0.5

    return winding
