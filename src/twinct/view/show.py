"""What the page shows of a run, at one moment: plain data, whoever reads or makes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.evaluate import pose_errors
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.motion import MotionPlan
from twinct.scenario import Scenario
from twinct.view.slices import release
from twinct.views import PosePairs
from twinct.volume import Volume

Image = NDArray[np.float32]

TRUTH = "truth"
RECONSTRUCTION = "reconstruction"


@dataclass(frozen=True, eq=False)
class Show:
    """A run as far as it is, or a scenario that was not run.

    Attributes:
        name: for people.
        scenario: of it.
        commanded: poses of all views.
        plan: that the arms follow; None where none is known, or with a gantry.
        poses: of the views on disk, by name of their geometry, ``executed`` first; the commanded
            ones are not among them.
        objects: ``world_from_object`` of the views on disk.
        joints: of the views on disk, rad, (views, joints).
        clearance_mm: of the views on disk, (views,).
        transmission: the image of a view on disk, (rows, columns).
        volumes: by name; ``reconstruction`` is the run's own, others bear the name they were given,
            ``truth`` is what they are judged against. Memory-mapped.
        residuals: of each iteration, by geometry.
        made: geometries of these poses that are made already, by name.
        refused: views that the arms cannot have, where there is no plan.
        state: in one line for people.
        problems: what a user should know, a sentence each.
    """

    name: str
    scenario: Scenario
    commanded: PosePairs
    plan: MotionPlan | None = None
    poses: Mapping[str, PosePairs] = field(default_factory=dict[str, PosePairs])
    objects: tuple[Pose, ...] = ()
    joints: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    clearance_mm: Floats = field(default_factory=lambda: np.zeros(0))
    transmission: Callable[[int], Image] | None = None
    volumes: Mapping[str, Volume] = field(default_factory=dict[str, Volume])
    residuals: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    made: Mapping[str, ScanGeometry] = field(default_factory=dict[str, ScanGeometry])
    refused: tuple[int, ...] = ()
    state: str = ""
    problems: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Number of views that it has, or shall have."""
        return len(self.commanded)

    @property
    def acquired(self) -> int:
        """Number of views on disk; they are the first."""
        return len(self.joints)

    @cached_property
    def geometries(self) -> Mapping[str, ScanGeometry]:
        """All geometries by name: ``commanded`` of all views, the others of those on disk."""
        panel, made = self.scenario.detector.panel, self.made
        return {
            name: made[name] if name in made else poses.geometry(panel)
            for name, poses in {"commanded": self.commanded, **self.poses}.items()
            if len(poses)
        }

    def geometry(self, name: str, view: int) -> tuple[str, ScanGeometry]:
        """The geometry of this name, or ``commanded`` where it does not have the view."""
        known = self.geometries.get(name)
        if known is None or view >= len(known):
            name = "commanded"
        return name, self.geometries[name]

    def joints_at(self, view: int) -> Floats | None:
        """Where the arms are in a view: reached, or planned; None where neither is known."""
        if view < self.acquired:
            return self.joints[view]
        return None if self.plan is None else np.asarray(self.plan.joints[view])

    def pose_errors_mm(self) -> dict[str, Floats]:
        """Distance of source and panel from the executed ones in each view on disk, by geometry.

        Names are as ``believed, source``; of the commanded ones, what the motion left.
        """
        executed = self.poses.get("executed")
        if executed is None or not len(executed):
            return {}
        found: dict[str, Floats] = {}
        for name, poses in {"commanded": self.commanded, **self.poses}.items():
            views = min(len(poses), len(executed))  # while a scan goes on not all have the newest
            if name != "executed" and views:
                errors = pose_errors(_first(poses, views), _first(executed, views))
                found[f"{name}, source"] = errors.source.position_mm
                found[f"{name}, panel"] = errors.detector.position_mm
        return found

    def window(self) -> tuple[float, float]:
        """Grey window that all its volumes share, 1/mm: air to a little above what is dense."""
        judged = self.volumes.get(TRUTH) or self.volumes.get(RECONSTRUCTION)
        if judged is None:
            return 0.0, 1.0
        top = float(np.percentile(judged.array[::4, ::4, ::4], 99.5))
        release(judged.array)
        return -0.1 * top, 1.3 * max(top, 1e-6)


def _first(poses: PosePairs, views: int) -> PosePairs:
    return PosePairs(poses.source[:views], poses.detector[:views])
