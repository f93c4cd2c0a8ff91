"""End of a scan in sweeps: it is complete once twice as many views hardly change the volume."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twinct.evaluation.region_voxels import VoxelSet, ball, whole
from twinct.geometry import Pose
from twinct.observers import Audience, Event, Said
from twinct.runs.volumes import reconstruct
from twinct.scan import Scan, Sweeps
from twinct.scenario import Scenario
from twinct.trajectory import ends_of_sweeps


class GrowingScan(Protocol):
    """A scan that is being taken."""

    @property
    def sweeps(self) -> Sweeps:
        """Comparisons so far."""
        ...

    def read(self) -> Scan:
        """Return the scan of the views taken."""
        ...

    def note(self, sweeps: Sweeps) -> None:
        """Keep the comparisons so far."""
        ...


@dataclass
class EarlyEnd:
    """Comparison of the volume after each sweep with that of half the views.

    Attributes:
        scenario: the scenario; without ``until``, its scans take all views.
        views: number of all views.
        scan: the scan.
        audience: hears of each comparison.
    """

    scenario: Scenario
    views: int
    scan: GrowingScan
    audience: Audience
    _volumes: dict[int, NDArray[np.float32]] = field(
        default_factory=dict[int, NDArray[np.float32]], repr=False
    )

    def enough(self, taken: int) -> bool:
        """Return True if the scan may end with the views taken."""
        until = self.scenario.until
        if until is None:
            return False
        ends = ends_of_sweeps(self.views, until.first)
        if taken not in ends[2:-1]:
            return False
        half = ends[ends.index(taken) - 2]
        known = self.scan.sweeps.changes_rel
        if taken not in known:  # a resumed scan may have compared them
            self.scan.note(Sweeps({**known, taken: self._change(taken, half)}))
        change = self.scan.sweeps.changes_rel[taken]
        self.audience.say(
            f"{taken} views change the volume of {half} views by {100 * change:.2g} % "
            f"(until.change_rel: {100 * until.change_rel:g} %)"
        )
        return change < until.change_rel

    def _change(self, taken: int, half: int) -> float:
        scan = self.scan.read()
        for number in (half, taken):
            if number not in self._volumes:
                part = scan.of_views(range(number))
                self._volumes[number] = reconstruct(part, observers=[self._hear]).array
        for number in [one for one in self._volumes if one < half]:
            del self._volumes[number]
        return relative_change(self._volumes[half], self._volumes[taken], self._region())

    def _hear(self, event: Event) -> None:
        """Pass on all but the warnings, which only the last volume deserves."""
        if not isinstance(event, Said):
            self.audience.tell(event)

    def _region(self) -> VoxelSet:
        """Return the voxels of the task's region, or all."""
        grid, task = self.scenario.reconstruction.volume_grid, self.scenario.task
        if task is not None:
            place = self.scenario.specimen.world_from_specimen.apply(np.array(task.position_mm))
            region = ball(grid, Pose.from_matrix(place, np.eye(3)), task.radius_mm)
            if len(region):
                return region
        return whole(np.ones(grid.shape, np.bool_))


def relative_change(
    before: NDArray[np.float32], after: NDArray[np.float32], region: VoxelSet
) -> float:
    """Return the root mean square of a change relative to that of the volume; 1 if it is empty."""
    square = float(np.mean(region.of(after) ** 2))
    return float(np.sqrt(np.mean(region.of(after - before) ** 2) / square)) if square else 1.0
