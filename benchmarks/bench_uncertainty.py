"""First-order covariances of a scan's errors against draws."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from twinct.runs.propagating import nominal_scan
from twinct.scan import SimulationBuilder
from twinct.scenario import PRESETS, Uncertainty, load_scenario
from twinct.uncertainty.propagation import propagate

DEMO = Path(__file__).parents[1] / "scenarios" / "demo.yaml"


def main() -> None:
    """Compare deviations of all numbers of all views, and correlations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=10_000)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--preset", default="collaborative")
    asked = parser.parse_args()
    scenario = load_scenario(DEMO, [f"trajectory.views={asked.views}"])
    scan = nominal_scan(SimulationBuilder(scenario))
    quiet = {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}}
    section = Uncertainty.model_validate({"arms": PRESETS[asked.preset]["arms"], **quiet})
    begun = time.perf_counter()
    found = propagate(
        section,
        scan,
        scenario.detector.panel,
        [[0.0, 0.0, 0.0]],
        draws=asked.draws,
        seed=1,
        arms_seed=1,
    )
    seconds = time.perf_counter() - begun
    views = range(asked.views)
    expected = np.block([[found.analytic.covariance(a, b) for b in views] for a in views])
    drawn = np.cov(found.errors.reshape(asked.draws, -1).T)
    sigma, of_draws = np.sqrt(np.diag(expected)), np.sqrt(np.diag(drawn))
    off = np.abs(drawn / np.outer(of_draws, of_draws) - expected / np.outer(sigma, sigma))
    off = off.reshape(asked.views, 12, asked.views, 12)
    within = off[views, :, views, :]
    across = within[:, :6, 6:].max(), off.max(axis=(1, 3))[~np.eye(asked.views, dtype=bool)].max()
    size = np.sqrt((found.errors.reshape(-1, 4, 3) ** 2).sum(-1).mean(0))
    sys.stdout.write(
        f"{asked.preset}, joint level: {asked.draws} draws of {asked.views} views in "
        f"{seconds:.1f} s\n"
        f"source {size[0]:.2f} mm, panel {size[2]:.2f} mm RMS\n"
        f"standard deviations off by {100 * np.abs(of_draws / sigma - 1).max():.2f} % at most\n"
        f"correlations off: source-panel {across[0]:.3f}, between views {across[1]:.3f} at most\n"
    )


if __name__ == "__main__":
    main()
