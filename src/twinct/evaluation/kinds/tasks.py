"""Detection of a signal in a region, from further reconstructions of the scan."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from twinct.core.foreign_text import quoted
from twinct.core.settings import setting
from twinct.evaluation.figure import Figure
from twinct.evaluation.figure_kind import (
    FigureKind,
    FigureSettings,
    Measurement,
    Name,
    NamedPlaces,
)
from twinct.evaluation.observer import detectability
from twinct.evaluation.region_voxels import Slices, VoxelSet
from twinct.geometry import Floats, VolumeGrid
from twinct.specimen.signals import AnySignal

log = logging.getLogger(__name__)

REACH = 2
"""Radius that the observer looks at, in radii of the signal, so that it also sees blur."""

MOST_INSERTS = 8
"""Copies of the signal in one reconstruction: the spread over eight shifts is known to a quarter,
and it is a small part of the whole."""


USUAL_SCANS = 4
"""Of two scans, the worst of ten d' is 20 % off an ensemble of 200 where the noise is blurred most
(``benchmarks/bench_observer.py --scans 2``); three differences instead of one narrow this."""


class DetectionTask(FigureSettings):
    """Detection of a signal in a region, rated by the index of detectability.

    Each task reconstructs the scan again with the signal inserted into its images, and all tasks
    together once more for each further scan.
    """

    name: Name = Field(description="Name of the figure.")
    signal: AnySignal = Field(description="Signal to detect.")
    region: str = Field(
        description="Name of the homogeneous region in which the signal lies; wider than the "
        "signal, as the noise is measured wherever the signal fits in."
    )
    scans: int = setting(
        USUAL_SCANS,
        "Scans with noise of their own, the run's included; more narrow the interval, each for "
        "one more reconstruction.",
        ge=2,
        le=200,
    )


def _measure(at: Measurement, task: DetectionTask) -> dict[str, float]:
    if at.again is None:
        log.warning(
            "no detectability of %s: it needs the scan of the volume, to reconstruct it again",
            task.name,
        )
        return {}
    places = _places(at.places, task)
    if places is None:
        return {}
    where = _inserts(places, _reach(task, at.grid), at.grid)
    shifted = where[:, ::-1] + _shifts(len(where))
    local = shifted * at.grid.voxel + at.grid.first_voxel_mm
    again = at.again(task.signal, at.grid.world_from_grid.apply(local), task.scans)
    half = _half(task, at.grid)
    seen = _seen(task, at.grid)
    signals = np.array(
        [
            seen * (again.with_signal[box].astype(np.float64) - again.without[0][box])
            for box in (_around(index, half) for index in where.tolist())
        ]
    )
    wide = _wider(places.box, half)
    errors = [one[wide].astype(np.float64) - at.truth[wide] for one in again.without]
    found = detectability(signals, errors, places.mask)
    return {
        "detectability": found.value,
        "detectability_low": found.low,
        "detectability_high": found.high,
        "detectability_quantum": found.quantum,
    }


def _reach(task: DetectionTask, grid: VolumeGrid) -> float:
    """Return the radius that the observer looks at, mm; at least that of two voxels."""
    return max(REACH * task.signal.extent_mm, 2 * float(grid.voxel.max()))


def _half(task: DetectionTask, grid: VolumeGrid) -> list[int]:
    """Return the voxels on either side of the template's middle, along z, y, x."""
    return np.ceil(_reach(task, grid) / grid.voxel[::-1]).astype(int).tolist()


def _seen(task: DetectionTask, grid: VolumeGrid) -> NDArray[np.bool_]:
    """Return the voxels of the template's box that the observer looks at, (z, y, x)."""
    sides = zip(_half(task, grid), grid.voxel[::-1], strict=True)
    axes = [np.arange(-n, n + 1) * edge for n, edge in sides]
    z, y, x = np.meshgrid(*axes, indexing="ij", sparse=True)
    return np.asarray(z * z + y * y + x * x <= _reach(task, grid) ** 2)


def _places(places: NamedPlaces, task: DetectionTask) -> VoxelSet | None:
    """Return the voxels at which the signal lies in the region and the template in the grid."""
    from scipy.ndimage import distance_transform_edt

    region, grid = places.region(task.region), places.grid
    if not len(region):
        return None
    padded = np.pad(region.mask, 1)
    depth = np.asarray(distance_transform_edt(padded, sampling=grid.voxel[::-1].tolist()))
    mask = depth[1:-1, 1:-1, 1:-1] > task.signal.extent_mm
    sides: list[slice] = []
    for axis, (side, half, count) in enumerate(
        zip(region.box, _half(task, grid), grid.shape, strict=True)
    ):
        others = tuple(n for n in range(3) if n != axis)
        filled = np.flatnonzero(mask.any(axis=others)) + side.start
        filled = filled[(filled >= half) & (filled < count - half)]
        if not len(filled):
            return None
        sides.append(slice(int(filled[0]), int(filled[-1]) + 1))
    z, y, x = sides
    inner = tuple(
        slice(s.start - b.start, s.stop - b.start) for s, b in zip(sides, region.box, strict=True)
    )
    found = VoxelSet((z, y, x), mask[inner])
    return found if len(found) else None


def _inserts(places: VoxelSet, reach_mm: float, grid: VolumeGrid) -> NDArray[np.intp]:
    """Return voxels for copies of the signal that do not see each other, (copies, 3), z, y, x.

    They are taken from the middle of the places outwards.
    """
    index = np.argwhere(places.mask) + [side.start for side in places.box]
    mm = index * grid.voxel[::-1]
    from_middle = np.linalg.norm(mm - mm.mean(axis=0), axis=1)
    apart, chosen = np.full(len(mm), np.inf), list[int]()
    while len(chosen) < MOST_INSERTS and (free := apart >= 2 * reach_mm).any():
        chosen.append(int(np.where(free, from_middle, np.inf).argmin()))
        apart = np.minimum(apart, np.linalg.norm(mm - mm[chosen[-1]], axis=1))
    return index[chosen]


def _shifts(count: int) -> Floats:
    """Return shifts within a voxel that fill it evenly, (count, 3), of its edges.

    The sequence of M. Roberts (The unreasonable effectiveness of quasirandom sequences, 2018): the
    n-th is n times the powers of 1 / g, modulo 1, with g^4 = g + 1.
    """
    g = 1.2207440846057596
    steps = np.arange(1, count + 1)[:, None] * g ** -np.arange(1.0, 4.0)
    return steps % 1 - 0.5


def _around(index: list[int], half: list[int]) -> Slices:
    z, y, x = (slice(i - n, i + n + 1) for i, n in zip(index, half, strict=True))
    return z, y, x


def _wider(box: Slices, half: list[int]) -> Slices:
    z, y, x = (slice(s.start - n, s.stop + n) for s, n in zip(box, half, strict=True))
    return z, y, x


def _check(places: NamedPlaces, task: DetectionTask) -> dict[str, str]:
    if not len(places.region(task.region)) or _places(places, task) is not None:
        return {}
    wide = 2 * task.signal.extent_mm
    return {
        "region": f"{quoted(task.region)} holds no place for a signal {wide:g} mm wide with "
        f"{_reach(task, places.grid):g} mm of the grid on all sides"
    }


_OBSERVER = "non-prewhitening observer; in noise, texture and shift"

TASKS = FigureKind(
    "tasks",
    DetectionTask,
    "Detection tasks; each needs further reconstructions.",
    (
        Figure(
            "detectability",
            "detectability d′",
            digits=2,
            meaning=_OBSERVER,
            best="higher",
            good="above 3",
            without_signal="null",
            blind_to=("shift",),
        ),
        Figure(
            "detectability_low",
            "d′, lower end",
            digits=2,
            meaning="of its interval of 95 %",
            good="above 3",
            without_signal="null",
        ),
        Figure(
            "detectability_high",
            "d′, upper end",
            digits=2,
            meaning="of its interval of 95 %",
            good="near the lower end",
            without_signal="null",
        ),
        Figure(
            "detectability_quantum",
            "d′, quantum noise alone",
            digits=2,
            meaning="without streaks and other texture, and without shift",
            best="higher",
            good="near d′: then noise limits, not views",
            without_signal="null",
            blind_to=("shift",),
        ),
    ),
    _measure,
    names={"region": "region"},
    check=_check,
    repeats=True,
)
