"""Content of the page for a run at one moment, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.evaluation import pose_errors
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.recon.volume import Volume
from twinct.robots.motion import MotionPlan
from twinct.scenario import Scenario
from twinct.viewer.slices import release

Image = NDArray[np.float32]

TRUTH = "truth"
RECONSTRUCTION = "reconstruction"


@dataclass(frozen=True, eq=False)
class Show:
    """Current state of a run, or a scenario that was not run.

    Attributes:
        name: name for users.
        scenario: the run's scenario.
        commanded: poses of all views.
        plan: the arms' plan; None if unknown, or for a gantry.
        poses: poses of the views on disk, by geometry, ``executed`` first, without ``commanded``.
        objects: ``world_from_object`` of the views on disk.
        joints: joint positions of the views on disk, rad, (views, joints).
        clearance_mm: clearances of the views on disk, (views,).
        transmission: returns the image of a view on disk, (rows, columns).
        volumes: memory-mapped volumes, by name: ``reconstruction`` is the run's own, ``truth`` the
            reference; others have the names they were given.
        residuals: residuals of each iteration, by geometry.
        made: geometries of these poses already built, by name.
        refused: views that the arms cannot reach, if there is no plan.
        state: state in one line, for users.
        problems: messages for users, one sentence each.
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
        """Return the number of views of the complete run."""
        return len(self.commanded)

    @property
    def acquired(self) -> int:
        """Number of views on disk, which are the first views."""
        return len(self.joints)

    @cached_property
    def geometries(self) -> Mapping[str, ScanGeometry]:
        """All geometries by name: ``commanded`` for all views, others for the views on disk."""
        panel, made = self.scenario.detector.panel, self.made
        return {
            name: made[name] if name in made else poses.geometry(panel)
            for name, poses in {"commanded": self.commanded, **self.poses}.items()
            if len(poses)
        }

    def geometry(self, name: str, view: int) -> tuple[str, ScanGeometry]:
        """Return the named geometry, or ``commanded`` if it lacks the view."""
        known = self.geometries.get(name)
        if known is None or view >= len(known):
            name = "commanded"
        return name, self.geometries[name]

    def joints_at(self, view: int) -> Floats | None:
        """Return the executed or else planned joint configuration of a view; None if unknown."""
        if view < self.acquired:
            return self.joints[view]
        return None if self.plan is None else np.asarray(self.plan.joints[view])

    def pose_errors_mm(self) -> dict[str, Floats]:
        """Return distances of source and panel from the executed ones in each view on disk, mm.

        Names are like ``believed, source``. The commanded ones give the error of the motion.
        """
        executed = self.poses.get("executed")
        if executed is None or not len(executed):
            return {}
        by_side: dict[str, Floats] = {}
        for name, poses in {"commanded": self.commanded, **self.poses}.items():
            views = min(len(poses), len(executed))  # some may lack a running scan's newest views
            if name != "executed" and views:
                errors = pose_errors(_first(poses, views), _first(executed, views))
                by_side[f"{name}, source"] = errors.source.position_mm
                by_side[f"{name}, panel"] = errors.detector.position_mm
        return by_side

    def window(self) -> tuple[float, float]:
        """Return the grey window of all volumes, 1/mm: from air to just above dense material."""
        judged = self.volumes.get(TRUTH) or self.volumes.get(RECONSTRUCTION)
        if judged is None:
            return 0.0, 1.0
        top = float(np.percentile(judged.array[::4, ::4, ::4], 99.5))
        release(judged.array)
        return -0.1 * top, 1.3 * max(top, 1e-6)


def _first(poses: PosePairs, views: int) -> PosePairs:
    return PosePairs(poses.source[:views], poses.detector[:views])
