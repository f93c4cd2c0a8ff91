"""Fit of a circle to the views of a scan, without assumptions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry

OFF_CIRCLE = 0.01
"""Largest distance of a source from the circle, and largest spread of the panel's distance.

They are shares of the radius and the SDD. Arms that trigger within 1 mm are at 0.003 on the paper's
radius.
"""

TILT_DEG = 1.0
"""Largest angle between the panel's normal and the radius, and between its v and the axis."""

UNEVEN = 0.5
"""Largest deviation of a step from the mean step, as a share of the mean step."""


@dataclass(frozen=True, eq=False)
class CircularOrbit:
    """Circular scan.

    Attributes:
        centre: centre in the world, (3,), mm.
        axis: unit vector of the rotation, right-handed from view to view, (3,).
        radius: radius of the fitted circle, mm.
        angles: angles of the sources about the axis, increasing from 0, (views,), rad.
        steps: arc that each view stands for, (views,), rad.
        full: True for a whole turn or more, False for an arc.
    """

    centre: Floats
    axis: Floats
    radius: float
    angles: Floats
    steps: Floats
    full: bool

    @property
    def span(self) -> float:
        """Arc that all views together stand for, rad."""
        return float(self.steps.sum())


def fit_circle(geometry: ScanGeometry, what: str = "fdk") -> CircularOrbit:
    """Fit the circle of a scan.

    The plane is a least-squares fit; the circle in the plane is fitted algebraically (Kasa 1976).

    Args:
        geometry: views of the scan.
        what: name of what needs the circle, for messages.

    Raises:
        InputError: the scan deviates from a circle by more than the bounds above; the error lists
            every deviation with its bound.
    """
    if len(geometry) < 3:
        raise InputError(f"{what} needs a circular scan of at least 3 views, not {len(geometry)}")
    s = geometry.source
    mean = s.mean(axis=0)
    normal = np.linalg.svd(s - mean)[2][2]
    e1 = s[0] - mean
    e1 -= normal * (e1 @ normal)
    if np.linalg.norm(e1) < 1e-9:
        raise InputError(f"{what} needs a circular scan: the sources of all views coincide")
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(normal, e1)
    x, y = (s - mean) @ e1, (s - mean) @ e2
    equations = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
    solution = cast(Any, np.linalg.lstsq(equations, x * x + y * y, rcond=1e-10))
    (cx, cy, c), rank = solution[0].tolist(), int(solution[2])
    square = c + cx * cx + cy * cy
    if rank < 3 or square <= 0:
        raise InputError(f"{what} needs a circular scan: the sources lie on a line")
    radius = float(np.sqrt(square))
    centre = mean + cx * e1 + cy * e2
    angles = np.unwrap(np.arctan2(y - cy, x - cx))
    if angles[-1] < angles[0]:
        normal, angles = -normal, -angles
    angles -= angles[0]
    steps, full = _steps(angles)
    circle = CircularOrbit(centre, normal, radius, angles, steps, full)
    problems = _problems(circle, geometry)
    if problems:
        raise InputError(f"{what} needs a circular scan: {'; '.join(problems)}")
    return circle


def _steps(angles: Floats) -> tuple[Floats, bool]:
    """Return the arc of each view, halfway to both neighbours, rad, and True for a full turn.

    The views of a turn that overlaps itself, or of several turns, are sorted by direction: where
    views come close, they share the arc. At the ends of an arc the inner half counts twice.
    """
    gaps = np.diff(angles)
    if 2 * np.pi - angles[-1] <= 1.5 * float(gaps.mean()):
        within = np.mod(angles, 2 * np.pi)
        order = np.argsort(within, kind="stable")
        within = within[order]
        around = np.concatenate([np.diff(within), [2 * np.pi - within[-1] + within[0]]])
        steps = np.empty_like(angles)
        steps[order] = (around + np.roll(around, 1)) / 2
        return steps, True
    before, after = np.concatenate([gaps[:1], gaps]), np.concatenate([gaps, gaps[-1:]])
    return (before + after) / 2, False


def _problems(circle: CircularOrbit, geometry: ScanGeometry) -> list[str]:
    problems: list[str] = []

    def bound(values: Floats, limit: float, unit: str, what: str) -> None:
        """Report the worst value if it exceeds the limit; ``what`` has a place for its view."""
        worst = int(np.abs(values).argmax())
        if not abs(values[worst]) <= limit:
            problems.append(
                f"{what.format(worst)} is {abs(values[worst]):.3g} {unit}; "
                f"at most {limit:.3g} {unit} is allowed"
            )

    arm = geometry.source - circle.centre
    height = arm @ circle.axis
    flat = arm - height[:, None] * circle.axis
    distance = np.linalg.norm(flat, axis=1)
    off = np.hypot(distance - circle.radius, height)
    bound(off, OFF_CIRCLE * circle.radius, "mm", "the distance of source {} from the circle")
    n = geometry.normal
    inwards = np.einsum("vk,vk->v", n, flat) / distance
    facing = np.degrees(np.arccos(np.clip(inwards, -1, 1)))
    bound(facing, TILT_DEG, "deg", "the angle between the normal and the radius of panel {}")
    turn = np.degrees(np.arccos(np.clip(np.abs(geometry.v @ circle.axis), 0, 1)))
    bound(turn, TILT_DEG, "deg", "the angle between the axis and v of panel {}")
    sdd = geometry.sdd
    away = f"the deviation of panel {{}} from the mean distance of {sdd.mean():.1f} mm"
    bound(sdd - sdd.mean(), OFF_CIRCLE * float(sdd.mean()), "mm", away)
    gaps = np.degrees(np.diff(circle.angles))
    uneven = (
        f"the deviation of the step after view {{}} from the mean step of {gaps.mean():.3g} deg"
    )
    bound(gaps - gaps.mean(), UNEVEN * abs(float(gaps.mean())), "deg", uneven)
    return problems
