"""Judges of the volumes of a scan: by the truth of a known specimen, or by what needs no truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.evaluation import ImageFigures
from twinct.geometry import Pose
from twinct.observers import Audience
from twinct.recon.volume import Volume
from twinct.report import CrossSection, cross_sections
from twinct.runs.folder import Folder
from twinct.runs.judgement import Judgement, judge_volume
from twinct.runs.regions import Places
from twinct.runs.repeated_figures import repeats_asked
from twinct.runs.repeats import Repeats
from twinct.runs.reporting import judge
from twinct.runs.truth import Truth, truth_of
from twinct.runs.volumes import reconstruct
from twinct.scan import Scan, ScanStore, SimulationBuilder


@dataclass(frozen=True, eq=False)
class ByTruth:
    """Judge of the volumes of a scan whose specimen is known.

    Attributes:
        scan: the scan.
        builder: parts of its scenario.
        folder: its folder, which keeps the truth.
        audience: notified of the stages.
    """

    scan: Scan
    builder: SimulationBuilder
    folder: Folder
    audience: Audience

    @cached_property
    def truth(self) -> Truth:
        """The truth on the grid of the reconstruction."""
        return truth_of(self.scan, self.builder, self.audience, file=self.folder.truth)

    @cached_property
    def _repeats(self) -> Repeats | None:
        asked = repeats_asked(self.scan.scenario)
        return Repeats(self.scan, self.builder, self.audience) if asked else None

    def figures(self, volume: Volume, which: str) -> ImageFigures:
        """Return the figures of a volume that was made from a geometry."""
        truth = self.truth
        again = self._repeats and self._repeats.of(which, volume.array)
        return judge(self.scan, volume, truth, self.builder.specimen, again)

    def slices(self, volume: Volume) -> dict[str, CrossSection]:
        """Return cross-sections of a volume and of the truth."""
        truth = self.truth
        return cross_sections(volume.array, truth.volume, truth.region, truth.grid)


@dataclass(frozen=True, eq=False)
class WithoutTruth:
    """Judge of the volumes of a scan whose specimen is not known.

    Attributes:
        scan: the scan.
        audience: notified of the stages.
        halves: reconstruct the even and the odd views, too, for the noise.
    """

    scan: Scan
    audience: Audience
    halves: bool = False

    @cached_property
    def _integrals(self) -> NDArray[np.float32]:
        return self.scan.line_integrals()

    def figures(self, volume: Volume, which: str) -> Judgement:
        """Return the figures of a volume that was made from a geometry."""
        parts = (self._half(which, 0), self._half(which, 1)) if self.halves else None
        with self.audience.stage("judge", 1) as step:
            geometry, bad = self.scan.geometry(which), self.scan.bad_pixels
            judged = judge_volume(volume, geometry, self._integrals, bad, parts)
            judged = replace(judged, further=self._further(volume))
            step()
        return judged

    def _further(self, volume: Volume) -> dict[str, Any]:
        """Return the figures that the settings request.

        Raises:
            InputError: regions without a voxel, each with its key.
        """
        settings = self.scan.settings
        if settings.evaluation is None:
            return {}
        places = Places(settings, None, Pose.identity(), volume.grid)
        if problems := places.check():
            raise InputError(problems)
        return places.figures(volume.array, None, math.nan)

    def _half(self, which: str, first: int) -> Volume:
        """Reconstruct every other view."""
        self.audience.say(f"{'odd' if first else 'even'} views alone, for the noise")
        part = self.scan.of_views(range(first, len(self.scan), 2))
        geometry = self.scan.geometry(which)[first::2]
        return reconstruct(part, geometry=geometry, observers=self.audience)

    def slices(self, volume: Volume) -> dict[str, CrossSection]:
        """Return cross-sections of a volume."""
        return cross_sections(volume.array, None, np.ones(volume.shape, bool), volume.grid)


def judge_of(
    scan: Scan, folder: Folder, audience: Audience, *, halves: bool = False
) -> ByTruth | WithoutTruth:
    """Return the judge of a scan's volumes.

    Args:
        scan: the scan, with the settings of its reconstruction.
        folder: its folder.
        audience: notified of the stages.
        halves: without a truth, also reconstruct the even and the odd views, for the noise.
    """
    if scan.settings.specimen is None:
        return WithoutTruth(scan, audience, halves)
    builder = SimulationBuilder(scan.scenario, ScanStore(folder.scan).plan)
    return ByTruth(scan, builder, folder, audience)
