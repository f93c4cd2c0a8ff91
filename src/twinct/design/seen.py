"""The question which part of the specimen the views see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from twinct.design.bench import Bench
from twinct.design.questions import Question
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.geometry.region import region_of_interest
from twinct.scenario import Scenario

VOXELS = 32
"""Voxels of the specimen's box along each axis: a share of the specimen is then known to 1 %."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Shares of the specimen's volume on the panel.

    Attributes:
        by_view: share that each view sees, (views,).
        by_all: share that every view sees, in which the volume is complete.
    """

    by_view: Floats
    by_all: float


@dataclass(frozen=True)
class SeenShare(Question):
    """The share of the specimen's volume that each view, and that every view, sees."""

    subject: ClassVar[str] = "seen"

    @staticmethod
    def reads(scenario: Scenario) -> object:
        """Return the sections that decide the shares."""
        return scenario.specimen, scenario.detector.panel, scenario.trajectory

    def answered(self, bench: Bench) -> Seen:
        """Return the shares."""
        builder = bench.builder(bench.scenario(self.source))
        specimen, views = builder.specimen, builder.requested
        low, high = (np.asarray(corner) for corner in specimen.bounds)
        place = specimen.world_from_specimen
        grid = VolumeGrid(
            (VOXELS,) * 3,
            ((high - low) / VOXELS).tolist(),
            place @ Pose.from_euler((low + high) / 2, np.zeros(3)),
        )
        amount = sum(
            share.astype(float) for part in specimen.parts for _, share in part.shares(grid, place)
        )
        whole = float(np.sum(amount)) or 1.0
        flags = [region_of_interest(views[view], grid) for view in range(len(views))]
        by_view = np.array([float((amount * flag).sum()) / whole for flag in flags])
        return Seen(by_view, float((amount * np.logical_and.reduce(flags)).sum()) / whole)
