"""The question for the dose of the path, with few photons: a price, not a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twinct.design.bench import Bench
from twinct.design.questions import Question
from twinct.runs.dosing import dose
from twinct.scenario import Scenario

PHOTONS, VOXEL_MM = 200_000, 4.0
"""Photons and voxels of an estimate; ``twinct dose`` follows 50 times as many."""


def dose_is_known(scenario: Scenario) -> bool:
    """Return True if a dose can be computed: the number of photons must be known."""
    source = scenario.source
    tube = source.spectrum is not None and source.spectrum.kind == "tube"
    return tube or source.photons_per_mm2_mas is not None


@dataclass(frozen=True)
class Exposure:
    """Dose of a path.

    Attributes:
        part: the part with the largest mass, or the reference if it is a part.
        mean_gy: mean dose of this part, Gy.
        error: relative standard error of this dose.
        kerma_area_product_gy_cm2: air kerma times area of the field, Gy cm^2.
    """

    part: str
    mean_gy: float
    error: float
    kerma_area_product_gy_cm2: float


@dataclass(frozen=True)
class PathDose(Question):
    """The dose of the commanded views to the specimen."""

    subject: ClassVar[str] = "dose"

    @staticmethod
    def reads(scenario: Scenario) -> object:
        """Return the sections that decide the dose."""
        return scenario.specimen, scenario.source, scenario.detector.panel, scenario.trajectory

    def answered(self, bench: Bench) -> Exposure:
        """Return the dose.

        Raises:
            InputError: the source has no photon number, or an energy is above 150 keV.
        """
        scenario = bench.scenario(self.source)
        found = dose(scenario, photons=PHOTONS, voxel_mm=VOXEL_MM, observers=bench.observers)
        names, masses = list(found.path.names), found.path.masses_g
        reference = scenario.specimen.reference
        place = names.index(reference) if reference in names else int(masses.argmax())
        return Exposure(
            names[place],
            float(found.path.doses[place]),
            float(found.path.errors[place]),
            found.kerma_area_product_gy_cm2,
        )
