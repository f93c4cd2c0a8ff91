"""What a reconstruction is judged against, and its figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.evaluate import ImageFigures, image_figures, region_of_interest
from twinct.progress import SILENT, Progress
from twinct.scan import Scan, Workshop
from twinct.volume import Volume


@dataclass(frozen=True, eq=False)
class Truth:
    """What a reconstruction is judged against.

    Attributes:
        volume: attenuation of the specimen, (z, y, x), 1/mm, float32.
        region: voxels that every view sees, (z, y, x), bool.
        mu_reference: attenuation to which figures are relative, 1/mm.
    """

    volume: NDArray[np.float32]
    region: NDArray[np.bool_]
    mu_reference: float


def truth_of(scan: Scan, workshop: Workshop, progress: Progress = SILENT) -> Truth:
    """The truth of a scan, where the specimen really was, and the region every view sees."""
    from twinct.xray.build import effective_energy_kev

    scenario = scan.scenario
    grid = scenario.reconstruction.grid.volume_grid
    energy = effective_energy_kev(scenario.source, scenario.detector)
    # The specimen stands still: any view's pose would do, but for rounding.
    stands = scan.executed_object[len(scan) // 2]
    with progress.stage("truth", 2) as step:
        volume = workshop.specimen.truth(grid, energy, stands)
        step()
        region = region_of_interest(scan.executed.geometry(scenario.detector.panel), grid)
        step()
    return Truth(volume, region, workshop.specimen.reference_mu(energy))


def judge(scan: Scan, volume: Volume, truth: Truth) -> ImageFigures:
    """The image figures of a reconstruction."""
    return image_figures(
        volume.array,
        truth.volume,
        truth.region,
        truth.mu_reference,
        scan.scenario.reconstruction.grid.volume_grid,
    )
