"""Volumes made worse than the truth on purpose, and their figures, detectability included."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from twinct.evaluation import Repeated
from twinct.recon.volume import Volume
from twinct.report import plain
from twinct.runs import Truth, judge, truth_of
from twinct.scan import Scan, SimulationBuilder
from twinct.scenario import load_scenario
from twinct.specimen.signals import contrast_at
from twinct.trajectory import commanded_views

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

Make = Callable[[np.ndarray, int], Any]
"""Volume of a true one and the number of a scan, which keys its noise."""


@dataclass(frozen=True)
class Judged:
    """Judge of volumes that are made of the truth."""

    scenario: Any
    builder: SimulationBuilder
    truth: Truth

    @classmethod
    def of(cls, keys: list[str]) -> Judged:
        scenario = load_scenario(DEMO, keys)
        builder = SimulationBuilder(scenario)
        return cls(scenario, builder, truth_of(_scan(scenario, builder), builder))

    def noise(self, size: float, scan: int) -> np.ndarray:
        """Return white noise, relative to the reference's attenuation."""
        drawn = np.random.default_rng([7, scan]).standard_normal(self.truth.grid.shape)
        return (size * self.truth.mu_reference * drawn).astype(np.float32)

    def __call__(self, make: Make) -> dict[str, Any]:
        """Return the figures of a volume, as in metrics.json."""

        def volume(truth: np.ndarray, scan: int) -> np.ndarray:
            made = np.broadcast_to(make(truth, scan), self.truth.grid.shape)
            return made.astype(np.float32)

        def again(signal: Any, centres_mm: np.ndarray, scans: int) -> Repeated:
            marked = self.truth.volume.astype(np.float64)
            for centre in centres_mm:
                marked += self.truth.mu_reference * self.ball(signal, centre)
            every = [volume(self.truth.volume, scan) for scan in range(scans)]
            return Repeated(every, volume(marked, 0))

        scan = _scan(self.scenario, self.builder)
        judged = Volume(volume(self.truth.volume, 0), self.truth.grid)
        figures = judge(scan, judged, self.truth, self.builder.specimen, again)
        return plain(figures.as_dict())

    def ball(self, signal: Any, centre_mm: np.ndarray) -> np.ndarray:
        """Return a signal's contrast in each voxel, relative to the reference's attenuation."""
        grid = self.truth.grid
        x, y, z = (a - c for a, c in zip(grid.axes(), centre_mm, strict=True))
        radius = np.sqrt(z[:, None, None] ** 2 + y[:, None] ** 2 + x**2)
        return contrast_at(signal, radius, float(grid.voxel.mean()))


def _scan(scenario: Any, builder: SimulationBuilder) -> Scan:
    views = commanded_views(scenario.trajectory, scenario.detector.panel)
    scan = SimpleNamespace(
        scenario=scenario,
        stands=builder.specimen.world_from_specimen,
        relative=SimpleNamespace(geometry=lambda panel: views),
    )
    return cast(Scan, scan)
