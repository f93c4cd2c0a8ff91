"""Builds the two simulations of a scenario; every link and every command builds them here.

The engines are imported only where they are used, so that a process loads no more than it needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from twinct.geometry import ScanGeometry
from twinct.scenario import Scenario
from twinct.specimen import BuiltSpecimen, build_specimen
from twinct.trajectory import commanded_views
from twinct.views import PosePairs, Target

if TYPE_CHECKING:
    from trimesh import Trimesh

    from twinct.cell import CellModel
    from twinct.motion import MotionPlan, RobotSimulation
    from twinct.xray import Imager


@dataclass(frozen=True)
class Workshop:
    """What a scenario describes, each part built once, when it is first asked for."""

    scenario: Scenario

    @cached_property
    def specimen(self) -> BuiltSpecimen:
        """Meshes, materials and truth of what is imaged."""
        return build_specimen(self.scenario.specimen)

    @cached_property
    def commanded(self) -> ScanGeometry:
        """The geometry the trajectory commands."""
        return commanded_views(self.scenario.trajectory, self.scenario.detector.panel)

    @cached_property
    def commanded_poses(self) -> PosePairs:
        """The same, as poses of the two end-effectors."""
        return PosePairs.from_geometry(self.commanded)

    @cached_property
    def targets(self) -> list[Target]:
        """The same, in the numbers that the links carry."""
        return self.commanded_poses.targets()

    @cached_property
    def cell(self) -> CellModel:
        """The operating room, the specimen as its convex hull: what the simulation needs."""
        return self._cell_with(self.hull)

    @cached_property
    def hull(self) -> Trimesh:
        """Convex hull of the specimen in its own frame, for collision."""
        return self.specimen.hull()

    @cached_property
    def room(self) -> CellModel:
        """The same room with the specimen as it looks, for pictures."""
        return self._cell_with(self.specimen.surface())

    def _cell_with(self, mesh: Trimesh) -> CellModel:
        from twinct.cell import build_cell

        pose, panel = self.specimen.world_from_specimen, self.scenario.detector.panel
        return build_cell(self.scenario.cell, mesh, pose, panel)

    @cached_property
    def plan(self) -> MotionPlan:
        """Joint configurations of all views.

        Raises:
            TrajectoryError: views that cannot be reached, or would collide.
        """
        from twinct.motion import plan_motion

        return plan_motion(self.cell, self.scenario.motion, self.targets)

    def robots(self) -> RobotSimulation:
        """A robot simulation at rest in the plan's home."""
        from twinct.motion import RobotSimulation, Shutter

        source, lags = self.scenario.source, self.scenario.detector.lag > 0
        shutter = Shutter(source.exposure_ms / 1000, source.motion_samples, lags)
        return RobotSimulation(self.cell, self.scenario.motion, self.plan.home, shutter)

    def imager(self) -> Imager:
        """An X-ray simulation of the specimen."""
        from twinct.xray import Imager

        source, detector, seed = self.scenario.source, self.scenario.detector, self.scenario.seed
        return Imager(source, detector, self.specimen, commanded=self.commanded, seed=seed)
