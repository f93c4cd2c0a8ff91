"""Deformations of a body: where its material is, and where it was in the reference state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose

Displacement = Callable[[Floats], Floats]
"""Displacements (n, 3) of points (n, 3), mm."""

STEP_MM = 0.5
"""Step of the differences that give a displacement's derivatives."""
PRECISION_MM = 1e-6
MOST_STEPS = 60
"""Accuracy of an inverse, and the largest number of its steps."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """A body at one instant: its material moved from p to p + displacement(p).

    Attributes:
        displacement: displacement of points of the reference state, in the body's frame.
        world_from_body: pose of that frame.
    """

    displacement: Displacement
    world_from_body: Pose

    def from_reference(self, points: Floats) -> Floats:
        """Return the place of material that was at points (n, 3) of the world, mm."""
        local = self.world_from_body.inverse().apply(points)
        return self.world_from_body.apply(local + self.displacement(local))

    def to_reference(self, points: Floats) -> Floats:
        """Return the points of the world where the material at ``points`` (n, 3) was, mm.

        Raises:
            InputError: no such point is found, as where a deformation folds.
        """
        local = self.world_from_body.inverse().apply(points)
        return self.world_from_body.apply(inverse(self.displacement, local))


def inverse(displacement: Displacement, points: Floats) -> Floats:
    """Return p with p + displacement(p) = points, (n, 3), by Newton's method.

    Raises:
        InputError: it does not converge.
    """
    found = points - displacement(points)
    for _ in range(MOST_STEPS):
        rest = found + displacement(found) - points
        if np.abs(rest).max(initial=0.0) < PRECISION_MM:
            return found
        moving = np.abs(rest).max(axis=1) >= PRECISION_MM
        slopes = jacobians(displacement, found[moving])
        found[moving] -= np.linalg.solve(slopes, rest[moving][:, :, None])[:, :, 0]
    rest = found + displacement(found) - points
    worst = int(np.abs(rest).max(axis=1).argmax())
    raise InputError(
        f"the displacement has no inverse near {_told(points[worst])} mm: after "
        f"{MOST_STEPS} steps {np.abs(rest[worst]).max():.3g} mm are left"
    )


def jacobians(displacement: Displacement, points: Floats) -> Floats:
    """Return the derivatives of p + displacement(p), (n, 3, 3), by central differences."""
    slopes = np.empty((len(points), 3, 3))
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = STEP_MM
        change = displacement(points + step) - displacement(points - step)
        slopes[:, :, axis] = change / (2 * STEP_MM)
        slopes[:, axis, axis] += 1.0
    return slopes


def require_no_fold(displacement: Displacement, points: Floats, where: str) -> float:
    """Check a displacement at points (n, 3), and return its smallest Jacobian determinant.

    Args:
        displacement: displacement of points, mm.
        points: points of the reference state, mm.
        where: beginning of the message.

    Raises:
        InputError: the displacement folds: a determinant is 0 or negative.
    """
    determinants = np.linalg.det(jacobians(displacement, points))
    worst = int(determinants.argmin())
    if not determinants[worst] > 0:
        raise InputError(
            f"{where} folds at {_told(points[worst])} mm: the determinant of its "
            f"Jacobian is {determinants[worst]:.3g}; it must be above 0"
        )
    return float(determinants[worst])


def _told(point: Floats) -> str:
    return "(" + ", ".join(f"{at:.1f}" for at in point) + ")"
