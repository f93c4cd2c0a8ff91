"""Range in which the error of the scatter kernel is known, and doubts of scans that leave it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.specimen import BuiltSpecimen, Part
from twinct.xray import sections
from twinct.xray.beam import fall_off
from twinct.xray.build import effective_energy_kev
from twinct.xray.paths import PathRenderer
from twinct.xray.scatter import ScatterKernel, compton_per_mm

LOWEST_KEV, MOST_DEPTH, LARGEST_ERROR = 40.0, 3.5, 0.25
"""Least photon energy, largest Compton optical depth, and error of the kernel up to there.

``benchmarks/bench_scatter.py``: of all balls of water from 40 to 120 keV, SOD and SDD of 300 and
600 mm or 750 and 1000 mm, whose shadow is on the panel, those with mu_C L <= 3.5 have scatter
between 25 % too low and 22 % too high. Beyond, the error reaches -28 and +160 %.
"""

MOST_BESIDE = 0.05
"""Share of the scatter on the panel that may come from rays beside the panel.

In the benchmark, the share adds to the error nearly in full, if the beam is open: 5 % take an error
of 20 % to 24 %.
"""

_RAYS, _VIEWS = 48, 12
"""Rays along the longer edge of a panel twice as wide, and views that are looked at."""


class ScatterLoad(NamedTuple):
    """Demand of one view on the scatter kernel.

    Attributes:
        depth: largest Compton optical depth of a ray to the panel.
        beside: share of the scatter on the panel, by the kernel, from rays that miss the panel but
            meet one twice as wide and high.
    """

    depth: float
    beside: float


def scatter_doubts(
    source: sections.Source,
    detector: sections.Detector,
    specimen: BuiltSpecimen,
    views: ScanGeometry,
    objects: Sequence[Part] = (),
) -> list[str]:
    """Return a warning for each limit of the scatter kernel that a scan exceeds.

    Args:
        source: source section of the scenario.
        detector: detector section; without a scatter kernel there is no warning.
        specimen: the specimen at its place.
        views: commanded views, in the world.
        objects: objects of the room that the beam sees.
    """
    if not isinstance(detector.scatter, sections.Scatter):
        return []
    energy = effective_energy_kev(source, detector)
    doubts: list[str] = []
    if energy < LOWEST_KEV:
        doubts.append(
            f"detector.scatter: the mean photon energy is {energy:.3g} keV; the kernel counts only "
            f"Compton scattering, and its error is known from {LOWEST_KEV:g} keV on"
        )
    looked = np.unique(np.linspace(0, len(views) - 1, _VIEWS).round().astype(int))
    loads = scatter_loads(energy, specimen, views[looked], objects)
    deepest = int(np.argmax([load.depth for load in loads]))
    if (depth := loads[deepest].depth) > MOST_DEPTH:
        doubts.append(
            f"detector.scatter: the Compton optical depth reaches {depth:.1f} (view "
            f"{looked[deepest]}); the kernel models single scattering, and its error is known up "
            f"to {MOST_DEPTH:g}, where scatter is up to {100 * LARGEST_ERROR:.0f} % wrong; beyond, "
            "expect larger errors"
        )
    widest = int(np.argmax([load.beside for load in loads]))
    if (beside := loads[widest].beside) > MOST_BESIDE:
        doubts.append(
            f"detector.scatter: the body is wider than the panel, and the kernel leaves out "
            f"scatter from rays that miss the panel, {100 * beside:.0f} % of the scatter (view "
            f"{looked[widest]}); use a larger panel, or state with detector.scatter.scale how much "
            "is missing"
        )
    return doubts


def scatter_loads(
    energy_kev: float,
    specimen: BuiltSpecimen,
    views: ScanGeometry,
    objects: Sequence[Part] = (),
) -> list[ScatterLoad]:
    """Return the demand of each view, at one photon energy, from a coarse lattice of rays."""
    own = _coarse(views.panel)
    wide = Panel(2 * own.rows, 2 * own.columns, own.pitch_u, own.pitch_v)
    rows, columns = (slice(n // 2, n // 2 + n) for n in own.shape)
    place, kernel = specimen.world_from_specimen, ScatterKernel(energy_kev)
    loads: list[ScatterLoad] = []
    with PathRenderer(specimen.parts, wide, engine="mesh", objects=objects) as renderer:
        compton = np.array([compton_per_mm(one, energy_kev) for one in renderer.materials])
        total = np.array([one.mu_per_mm(energy_kev) for one in renderer.materials])
        for view in views:
            seen = ScanGeometry(view.source, view.detector, view.u, view.v, wide)
            paths = renderer.render(seen, place).astype(np.float64)
            depth = np.tensordot(compton, paths, axes=1)
            primary = fall_off(seen, 1) * np.exp(-np.tensordot(total, paths, axes=1))
            scattered = (primary * depth).astype(np.float32)
            pitch, middle_mm = (wide.pitch_u, wide.pitch_v), _middle_mm(specimen, place, view)
            beside = scattered.copy()
            beside[rows, columns] = 0
            found, missed = (
                float(kernel.spread(one, *pitch, middle_mm)[rows, columns].sum())
                for one in (scattered, beside)
            )
            share = missed / found if found > 0 else 0.0
            loads.append(ScatterLoad(float(depth[rows, columns].max()), share))
    return loads


def _coarse(panel: Panel) -> Panel:
    """Return a panel of the same size with an even number of few rows and columns."""
    width, height = panel.size_mm
    pitch = max(width, height) / (_RAYS // 2)
    rows, columns = (max(2, 2 * round(edge / pitch / 2)) for edge in (height, width))
    return Panel(rows, columns, width / columns, height / rows)


def _middle_mm(specimen: BuiltSpecimen, place: Pose, view: ScanGeometry) -> float:
    low, high = specimen.bounds
    return float((place.apply((low + high) / 2) - view.detector[0]) @ view.normal[0])
