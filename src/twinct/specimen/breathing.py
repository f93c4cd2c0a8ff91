"""Breathing of a patient: a simple model of the chest, and fields of the user's own.

A state of breathing is a pure function of time and seed, a displacement one of point and state. In
one breath, from full exhalation to full exhalation, the diaphragm follows

    a(phase) = sin(pi phase)^4,

the form of Lujan et al., Med. Phys. 26 (1999) 715, with its long rest at exhalation. The front of
the chest leads it by h sin(2 pi phase) in its rise and lags as far in its fall: that is the
hysteresis. Each breath has its own length and depth; the drift adds up slowly. Material moves
towards the feet at the diaphragm, fading to the lungs' tips, the hips, the spine and the skin. In
the front wall of the chest it moves to the front.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from twinct.core.draws import view_rng
from twinct.geometry import Floats
from twinct.specimen.deformation import require_no_fold

STEEPEST = 4
"""Power of the sine in the breath's course."""
CHECK_MM = 8.0
"""Distance of the points at which folding is looked for."""


@dataclass(frozen=True)
class Breath:
    """State of breathing at one instant.

    Attributes:
        phase: share of the breath that is over, 0 to 1; 0 is full exhalation.
        depth: depth of this breath, relative to the usual one.
        drift: drift of the diaphragm since the start, relative to the usual depth.
    """

    phase: float
    depth: float = 1.0
    drift: float = 0.0


@dataclass(frozen=True)
class Rhythm:
    """Course of breathing over time.

    Attributes:
        period_s: mean length of a breath.
        irregularity: standard deviation of the logarithm of a breath's length and depth.
        drift_per_min: drift, in usual depths a minute.
        seed: seed of the irregularity.
        start_phase: share of the first breath that is over at time 0.
    """

    period_s: float = 4.0
    irregularity: float = 0.0
    drift_per_min: float = 0.0
    seed: int = 0
    start_phase: float = 0.0

    def at(self, time_s: float) -> Breath:
        """Return the state at a time, s; negative times have that of time 0."""
        drift = self.drift_per_min * time_s / 60.0
        time_s = max(time_s, 0.0) + self.start_phase * float(self._lengths(1)[0])
        count = 1 + int(time_s / self.period_s)
        ends = np.cumsum(self._lengths(count))
        while ends[-1] <= time_s:
            count *= 2
            ends = np.cumsum(self._lengths(count))
        breath = int(np.searchsorted(ends, time_s, side="right"))
        start = ends[breath - 1] if breath else 0.0
        phase = (time_s - start) / (ends[breath] - start)
        depth = _drawn(self.seed, self.irregularity, breath)[1]
        return Breath(float(phase), depth, drift)

    def _lengths(self, count: int) -> Floats:
        draws = (_drawn(self.seed, self.irregularity, breath)[0] for breath in range(count))
        return self.period_s * np.array(list(draws))


@lru_cache(maxsize=4096)
def _drawn(seed: int, irregularity: float, breath: int) -> tuple[float, float]:
    """Return length and depth of one breath, relative to the usual ones."""
    length, depth = np.exp(irregularity * view_rng(seed, "breath", breath).standard_normal(2))
    return float(length), float(depth)


class Displacement(Protocol):
    """Displacement of points of a patient in a state of breathing, mm; a pure function."""

    def __call__(self, points: Floats, breath: Breath) -> Floats:
        """Return the displacements (n, 3) of points (n, 3) of the reference state."""
        ...

    def rests(self, breath: Breath) -> bool:
        """Return True if nothing is displaced in a state."""
        ...


@dataclass(frozen=True)
class Chest:
    """Simple model of a breathing chest in the axes of the trunk phantom: right, front, up.

    Attributes:
        diaphragm_mm: way of the diaphragm's dome towards the feet in a usual breath.
        front_mm: way of the chest's front wall to the front.
        hysteresis: lead of the front wall over the diaphragm, as a share of its way.
        dome_mm: point of the dome, right, front, up.
        reach_mm: lengths above and below the dome over which its way fades away.
        half_axes_mm: half axes of the chest across and from back to front.
    """

    diaphragm_mm: float = 15.0
    front_mm: float = 6.0
    hysteresis: float = 0.2
    dome_mm: tuple[float, float, float] = (0.0, 10.0, -20.0)
    reach_mm: tuple[float, float] = (200.0, 200.0)
    half_axes_mm: tuple[float, float] = (165.0, 114.0)

    def __call__(self, points: Floats, breath: Breath) -> Floats:
        """Return the displacements (n, 3) of points (n, 3) of full exhalation, mm."""
        course = np.sin(np.pi * breath.phase) ** STEEPEST
        lead = self.hysteresis * np.sin(2 * np.pi * breath.phase)
        down = self.diaphragm_mm * (breath.depth * course + breath.drift)
        forward = self.front_mm * (breath.depth * (course + lead) + breath.drift)
        x, y, z = points.T
        wide, deep = self.half_axes_mm
        up = z - self.dome_mm[2]
        along = _bell(np.where(up > 0, up / self.reach_mm[0], up / self.reach_mm[1]))
        inside = 1 - _ease((np.hypot(x / wide, y / deep) - 0.5) / 0.45)
        off_spine = _ease((y + 0.35 * deep) / (0.5 * deep))
        front = _ease((y + 0.4 * deep) / (1.3 * deep)) * _bell(x / (1.2 * wide))
        moved = np.zeros_like(points)
        moved[:, 1] = forward * front * _bell(up / (1.3 * max(self.reach_mm)))
        moved[:, 2] = -down * along * inside * off_spine
        return moved

    def rests(self, breath: Breath) -> bool:
        """Return True at full exhalation without drift."""
        return breath.phase == 0 and breath.drift == 0


def _ease(t: Floats) -> Floats:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _bell(t: Floats) -> Floats:
    """Return cos(pi t / 2)^2 within |t| < 1, else 0."""
    return np.cos(np.pi / 2 * np.clip(t, -1.0, 1.0)) ** 2


@dataclass(frozen=True, eq=False)
class PhaseFields:
    """Displacements of the user's own: one field of vectors for each of evenly spaced phases.

    Between phases, of which the first follows the last, and between voxels they are linear; beyond
    the grid they keep the border's value. They scale with the depth of a breath and its drift adds
    that share of the largest field.

    Attributes:
        vectors: (phases, nz, ny, nx, 3), mm along x, y, z of the part's frame.
        affine: matrix (4, 4) from indices (x, y, z) to that frame, mm.
    """

    vectors: Floats
    affine: Floats

    def __call__(self, points: Floats, breath: Breath) -> Floats:
        """Return the displacements (n, 3) of points (n, 3), mm."""
        import scipy

        count = len(self.vectors)
        at = (breath.phase % 1.0) * count
        first = int(at) % count
        field = (1 - at % 1) * self.vectors[first] + at % 1 * self.vectors[(first + 1) % count]
        field = breath.depth * field
        if breath.drift:
            field = field + breath.drift * self.vectors[self._largest]
        turned, origin = self.affine[:3, :3], self.affine[:3, 3]
        index = np.linalg.solve(turned, (points - origin).T)[::-1]
        read = scipy.ndimage.map_coordinates
        return np.stack([read(field[..., i], index, order=1, mode="nearest") for i in range(3)], 1)

    def rests(self, breath: Breath) -> bool:
        """Return True if the first phase is the reference state, and the breath is in it."""
        return breath.phase == 0 and breath.drift == 0 and not self.vectors[0].any()

    @cached_property
    def _largest(self) -> int:
        """The phase with the largest displacement."""
        return int(np.abs(self.vectors).reshape(len(self.vectors), -1).max(axis=1).argmax())


def require_smooth(
    motion: Displacement, breaths: list[Breath], bounds: Floats, where: str
) -> float:
    """Check that no state of breathing folds the patient.

    Args:
        motion: displacement of points.
        breaths: states to check.
        bounds: lowest and highest corner of the patient in the specimen's frame, (2, 3), mm.
        where: beginning of the message.

    Returns:
        The smallest determinant of a Jacobian.

    Raises:
        InputError: a state folds.
    """
    axes = [np.arange(low, high + CHECK_MM, CHECK_MM) for low, high in bounds.T]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    results = [
        require_no_fold(
            lambda p, b=breath: motion(p, b), points, f"{where}, phase {breath.phase:.3g},"
        )
        for breath in breaths
    ]
    return min(results)


def gated(breaths: list[Breath], window: tuple[float, float]) -> list[int]:
    """Return the views whose phase lies in a window; one whose start exceeds its end wraps around.

    Args:
        breaths: state at each view.
        window: first and last phase, 0 to 1.
    """
    low, high = window
    inside = [
        low <= b.phase <= high if low <= high else b.phase >= low or b.phase <= high
        for b in breaths
    ]
    return [view for view, yes in enumerate(inside) if yes]
