"""Content of the page for a scan or a plan at one moment, as plain data."""

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
from twinct.scan import Provenance, Simulated
from twinct.scenario import AnyCell, CArm, GantryCell, Scenario
from twinct.scenario.imported import ScanSettings
from twinct.viewer.slices import release

Image = NDArray[np.float32]

TRUTH = "truth"
RECONSTRUCTION = "reconstruction"


@dataclass(frozen=True, eq=False)
class Show:
    """Current state of a scan, or a scenario that was not run.

    Attributes:
        name: name for users.
        settings: scenario of the scan, or what is known of an imported one.
        first: poses of all views that were known beforehand: commanded or stated ones.
        kind: kind of the provenance, which names ``first`` and the poses at exposure.
        plan: the arms' plan; None if unknown, or for a gantry.
        poses: poses of the views on disk, by geometry, those at exposure first, without commanded.
        objects: ``world_from_object`` of the views on disk; empty if it is not known.
        joints: joint positions of the views on disk, rad, (views, joints); empty without arms.
        clearance_mm: clearances of the views on disk, (views,); empty without arms.
        transmission: returns the image of a view on disk, (rows, columns).
        volumes: memory-mapped volumes, by name: ``reconstruction`` is the run's own, ``truth`` the
            reference; others have the names they were given.
        residuals: residuals of each iteration, by geometry of the run's own volume, and by name of
            further ones.
        view_residuals: residual of each view, relative to the line integrals of all, by name of a
            volume that is judged without a truth.
        made: geometries of these poses already built, by name.
        refused: views that the arms cannot reach, if there is no plan.
        state: state in one line, for users.
        problems: messages for users, one sentence each.
    """

    name: str
    settings: ScanSettings
    first: PosePairs
    kind: type[Provenance] = Simulated
    plan: MotionPlan | None = None
    poses: Mapping[str, PosePairs] = field(default_factory=dict[str, PosePairs])
    objects: tuple[Pose, ...] = ()
    joints: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    clearance_mm: Floats = field(default_factory=lambda: np.zeros(0))
    transmission: Callable[[int], Image] | None = None
    volumes: Mapping[str, Volume] = field(default_factory=dict[str, Volume])
    residuals: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    view_residuals: Mapping[str, Floats] = field(default_factory=dict[str, Floats])
    made: Mapping[str, ScanGeometry] = field(default_factory=dict[str, ScanGeometry])
    refused: tuple[int, ...] = ()
    state: str = ""
    problems: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of views of the complete run."""
        return len(self.first)

    @property
    def c_arm(self) -> CArm | None:
        """The C-arm that carries source and panel, if any."""
        return self.cell.c_arm if isinstance(self.cell, GantryCell) else None

    @property
    def first_name(self) -> str:
        """Name of the geometry of all views."""
        return self.kind.own[0]

    @property
    def kept(self) -> str:
        """Name of the geometry at which the images were taken, as far as known."""
        return self.kind.kept

    @property
    def acquired(self) -> int:
        """Number of views on disk, which are the first views."""
        return len(self.poses.get(self.kept, ()))

    @property
    def scenario(self) -> Scenario | None:
        """The scenario; None of an imported scan."""
        return self.settings if isinstance(self.settings, Scenario) else None

    @property
    def cell(self) -> AnyCell | None:
        """The room with its machine; None if it is not known."""
        return None if self.scenario is None else self.scenario.cell

    @property
    def place(self) -> Pose:
        """``world_from_specimen`` of the scenario; the world without one."""
        known = self.scenario
        return Pose.identity() if known is None else known.specimen.world_from_specimen

    @cached_property
    def reach_mm(self) -> float:
        """Largest distance of a source or panel from the origin."""
        bodies = (*self.first.source, *self.first.detector)
        return max(float(np.linalg.norm(pose.position)) for pose in bodies)

    @property
    def main_volume(self) -> str:
        """Name of the volume to show first; empty without volumes."""
        return RECONSTRUCTION if RECONSTRUCTION in self.volumes else next(iter(self.volumes), "")

    @cached_property
    def geometries(self) -> Mapping[str, ScanGeometry]:
        """All geometries by name: the first one for all views, others for the views on disk."""
        panel, made = self.settings.detector.panel, self.made
        return {
            name: made[name] if name in made else poses.geometry(panel)
            for name, poses in self._named.items()
            if len(poses)
        }

    @property
    def _named(self) -> Mapping[str, PosePairs]:
        taken = {name: poses for name, poses in self.poses.items() if name != self.first_name}
        return {self.first_name: self.first, **taken}

    @property
    def taken(self) -> ScanGeometry | None:
        """Geometry at which the images on disk were taken, as far as known; None without any."""
        return self.geometries.get(self.kept) if self.acquired else None

    def geometry(self, name: str, view: int) -> tuple[str, ScanGeometry]:
        """Return the named geometry, or that of all views if it lacks the view."""
        known = self.geometries.get(name)
        if known is None or view >= len(known):
            name = self.first_name
        return name, self.geometries[name]

    def poses_at(self, view: int) -> tuple[Pose, Pose]:
        """Return the poses of source and panel at exposure or, before it, the first ones."""
        return (self.poses[self.kept] if view < self.acquired else self.first)[view]

    def joints_at(self, view: int) -> Floats | None:
        """Return the executed or else planned joint configuration of a view; None if unknown."""
        if view < len(self.joints):
            return self.joints[view]
        return None if self.plan is None else np.asarray(self.plan.joints[view])

    def pose_errors_mm(self) -> dict[str, Floats]:
        """Return distances of source and panel from those at exposure in each view on disk, mm.

        Names are like ``believed, source``. The commanded ones give the error of the motion.
        """
        if not self.acquired:
            return {}
        taken = self.poses[self.kept]
        by_side: dict[str, Floats] = {}
        for name, poses in self._named.items():
            views = min(len(poses), len(taken))  # some may lack a running scan's newest views
            if name != self.kept and views:
                errors = pose_errors(_first(poses, views), _first(taken, views))
                by_side[f"{name}, source"] = errors.source.position_mm
                by_side[f"{name}, panel"] = errors.detector.position_mm
        return by_side

    def window(self) -> tuple[float, float]:
        """Return the grey window of all volumes, 1/mm: from air to just above dense material."""
        judged = self.volumes.get(TRUTH) or self.volumes.get(self.main_volume)
        if judged is None:
            return 0.0, 1.0
        top = float(np.percentile(judged.array[::4, ::4, ::4], 99.5))
        release(judged.array)
        return -0.1 * top, 1.3 * max(top, 1e-6)


def _first(poses: PosePairs, views: int) -> PosePairs:
    return PosePairs(poses.source[:views], poses.detector[:views])
