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
PRECISION_MM = 1e-5
MOST_STEPS = 60
"""Accuracy of an inverse, and the largest number of its steps."""
STEPS_A_SLOPE = 6
"""Steps of an inverse with the same derivatives."""


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


@dataclass(frozen=True, eq=False)
class Between:
    """A body at one instant, as seen from another of its states, which a volume holds.

    Attributes:
        now: deformation at the instant, from the reference state.
        held: deformation of the state that the volume holds.
    """

    now: Deformation
    held: Deformation

    def from_reference(self, points: Floats) -> Floats:
        """Return the place at the instant of material at points (n, 3) of the volume, mm."""
        return self.now.from_reference(self.held.to_reference(points))

    def to_reference(self, points: Floats) -> Floats:
        """Return the points of the volume where the material at ``points`` (n, 3) is, mm.

        Raises:
            InputError: as in ``Deformation``.
        """
        return self.held.from_reference(self.now.to_reference(points))


def inverse(displacement: Displacement, points: Floats) -> Floats:
    """Return p with p + displacement(p) = points, (n, 3), by Newton's method.

    A point keeps its derivatives for ``STEPS_A_SLOPE`` steps, since they cost six displacements.

    Raises:
        InputError: it does not converge.
    """
    points_before = points - displacement(points)
    left, rest = np.arange(len(points)), np.zeros((0, 3))
    slopes = np.zeros((0, 3, 3))
    for step in range(MOST_STEPS):
        rest = points_before[left] + displacement(points_before[left]) - points[left]
        moving = ~(np.abs(rest).max(axis=1) < PRECISION_MM)
        left, rest = left[moving], rest[moving]
        if not len(left):
            return points_before
        fresh = step % STEPS_A_SLOPE == 0
        slopes = jacobians(displacement, points_before[left]) if fresh else slopes[moving]
        points_before[left] -= np.linalg.solve(slopes, rest[:, :, None])[:, :, 0]
    worst = int(np.abs(rest).max(axis=1).argmax())
    raise InputError(
        f"the displacement has no inverse near {_in_words(points[left[worst]])} mm: after "
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
            f"{where} folds at {_in_words(points[worst])} mm: the determinant of its "
            f"Jacobian is {determinants[worst]:.3g}; it must be above 0"
        )
    return float(determinants[worst])


def _in_words(point: Floats) -> str:
    return "(" + ", ".join(f"{at:.1f}" for at in point) + ")"
