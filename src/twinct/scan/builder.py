"""Construction of a scenario's two simulations, for every link and every command.

Engines are imported only where they are used, so that a process loads no more than it needs.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from twinct.core.cached import once
from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose, ScanGeometry, fibonacci_directions
from twinct.geometry.wire import PosePairs, places_m, targets_of
from twinct.robots.gantry import Gantry
from twinct.scenario import Cell, GantryCell, Scenario, plan_digest, specimen_digest
from twinct.specimen import BuiltPart, BuiltSpecimen, build_specimen
from twinct.specimen.built_file import load_built
from twinct.specimen.surface import joined
from twinct.trajectory import commanded_mas, commanded_views, in_sweeps
from twinct.uncertainty import TrueCell

if TYPE_CHECKING:
    from trimesh import Trimesh

    from twinct.robots.cell import CellModel, Gap, Marks
    from twinct.robots.motion import MotionPlan, PursuingSimulation, Shutter
    from twinct.xray import Imager


ROUGH_DIRECTIONS = 150
"""Directions in which the simpler specimen of a search for remedies has its corners."""


@dataclass(frozen=True)
class SimulationBuilder:
    """Parts of a scenario, each built once, on first use.

    Attributes:
        scenario: the scenario.
        given_plan: plan that a scan of the scenario already follows; None to compute or read one.
        given_specimen: the specimen, if it is already built.
        given_cell: ``cell``, if it is already built.
    """

    scenario: Scenario
    given_plan: MotionPlan | None = None
    given_specimen: BuiltSpecimen | None = None
    given_cell: CellModel | None = None

    def of_changed(self, scenario: Scenario) -> Self:
        """Return a builder of a changed scenario, with the parts that the change leaves as is."""
        kept = "cell" in self.__dict__ and _decide_cell(scenario) == _decide_cell(self.scenario)
        cell = self.cell if kept else None
        changed = replace(
            self, scenario=scenario, given_plan=None, given_specimen=None, given_cell=cell
        )
        if scenario.specimen == self.scenario.specimen:
            for name in ("specimen", "_obstacles"):
                if name in vars(self):
                    vars(changed)[name] = vars(self)[name]
        return changed

    @classmethod
    def with_specimen(cls, scenario: Scenario, file: Path | None) -> Self:
        """Return a builder with the specimen from a file of ``save_built``; None builds it.

        Raises:
            InputError: the file does not hold the scenario's specimen.
        """
        built = None if file is None else load_built(scenario.specimen, file)
        return cls(scenario, given_specimen=built)

    @cached_property
    def specimen(self) -> BuiltSpecimen:
        """Meshes, materials and ground truth of the specimen."""
        if self.given_specimen:
            return self.given_specimen
        from twinct.specimen.known_names import require_known_names

        whole = self.scenario
        require_known_names(whole.specimen, whole.named_parts(), whole.unknown_parts)
        built = once("specimen", self._body_digest, self._built)
        return built.placed(self.scenario.specimen.world_from_specimen)

    @property
    def _body_digest(self) -> str:
        """SHA-256 of all that decides the specimen, except for its place."""
        section = self.scenario.specimen
        still = section.model_copy(update={"position_mm": (0, 0, 0), "rotation_deg": (0, 0, 0)})
        names = [part.label for part in section.parts]
        body = specimen_digest(self.scenario.model_copy(update={"specimen": still}))
        return hashlib.sha256(json.dumps([body, names]).encode()).hexdigest()

    def _built(self) -> BuiltSpecimen:
        return build_specimen(self.scenario.specimen)

    @cached_property
    def requested(self) -> ScanGeometry:
        """Views that the trajectory requests, in its order, or in sweeps if the scenario does."""
        views = commanded_views(self.scenario.trajectory, self.scenario.detector.panel)
        return views if self.scenario.until is None else views[self._in_sweeps]

    @cached_property
    def _in_sweeps(self) -> list[int]:
        """Numbers of the trajectory's views in the order of the sweeps of ``until``."""
        until = self.scenario.until
        assert until is not None
        views = commanded_views(self.scenario.trajectory, self.scenario.detector.panel)
        return in_sweeps(views, until.first)

    @cached_property
    def commanded(self) -> ScanGeometry:
        """Commanded geometry, with the plan's choices if it has any."""
        if not self.plan_chooses:
            return self.requested
        return self.commanded_poses.geometry(self.scenario.detector.panel)

    @cached_property
    def mas(self) -> Floats | None:
        """Tube load of each commanded view, (views,), mAs; None if all have ``source.mas``."""
        mas = commanded_mas(self.scenario.trajectory)
        if mas is not None and self.scenario.until is not None:
            mas = mas[self._in_sweeps]
        if mas is None or not self.plan_chooses:
            return mas
        # If the plan chose the order, positions identify the views.
        places = np.array([places_m(target) for target in targets_of(self.requested)])
        order: list[int] = []
        for target in self.targets:
            far = np.abs(places - places_m(target)).max(axis=1)
            far[order] = np.inf
            order.append(int(far.argmin()))
        return mas[order]

    @cached_property
    def plan_chooses(self) -> bool:
        """True if the plan chooses the order of views, or the roll of source or panel."""
        motion = self.scenario.motion
        if self.scenario.cell.kind == "gantry" or motion.scheme == "reactive":
            return False
        return motion.order != "given" or any(self._roll_free)

    @cached_property
    def _roll_free(self) -> tuple[bool, bool]:
        from twinct.robots.motion import roll_free

        return roll_free(self.scenario.motion, self.scenario.trajectory, self.scenario.source)

    @property
    def roll_free(self) -> tuple[bool, bool]:
        """True for source and for panel if the scheme may roll them about the beam."""
        reactive = self.scenario.motion.scheme == "reactive"
        return (False, False) if reactive else self._roll_free

    @cached_property
    def commanded_poses(self) -> PosePairs:
        """Commanded poses of the two end-effectors."""
        plan = self.plan if self.plan_chooses else None
        if plan is None:
            return PosePairs.from_geometry(self.requested)
        return PosePairs.joined(plan.targets)

    @cached_property
    def targets(self) -> list[PosePairs]:
        """Commanded poses of each view, as messages carry them."""
        plan = self.plan if self.plan_chooses else None
        return targets_of(self.requested) if plan is None else list(plan.targets)

    @cached_property
    def cell(self) -> CellModel:
        """Operating room with the specimen as its obstacle, for simulation.

        Raises:
            ScenarioError: an arm cannot be built, or fixed bodies overlap.
        """
        if self.given_cell is not None:
            return self.given_cell
        from twinct.robots.cell import apart, overlaps

        # The specimen may lie closer to its table than to an arm.
        cell, hulls = self._cell_with(self._obstacles), self.specimen.hulls
        if self._obstacles is hulls:
            return apart(cell)
        if overlaps(cell):
            apart(self._cell_with(hulls))
        return cell

    @cached_property
    def hull(self) -> Trimesh:
        """Convex hull of the specimen in its own frame."""
        return self.specimen.hull

    @cached_property
    def beam_objects(self) -> tuple[BuiltPart, ...]:
        """Objects of the room that the beam sees, in the world.

        Raises:
            SpecimenError: a material is unknown, or a mesh file is unusable.
        """
        from twinct.specimen.room_bodies import beam_bodies

        return beam_bodies(self.scenario.cell.keyed_objects)

    @cached_property
    def _obstacles(self) -> tuple[Trimesh, ...]:
        """Convex bodies of the specimen, with its safety distance."""
        return self.specimen.obstacles(self.scenario.specimen.safety_mm)

    @cached_property
    def room(self) -> CellModel:
        """Operating room with the true surface of the specimen, for pictures."""
        return self._painted(self._cell_with(self.specimen.hulls, self.specimen.surface()))

    @cached_property
    def sketched_room(self) -> CellModel:
        """Operating room with a coarse surface of the specimen, for pictures in a hurry."""
        from twinct.specimen.sketch import sketch

        return self._painted(self._cell_with((), sketch(self.specimen.surface())))

    def _painted(self, room: CellModel) -> CellModel:
        from twinct.robots.cell import paint_specimen

        paint_specimen(room, self.specimen.colour)
        return room

    def urdf(self, meshes: Path | None = None) -> str:
        """Return the room's robot description, with the camera at the first view's source.

        Args:
            meshes: folder for the meshes that it names; None for boxes instead of meshes.

        Raises:
            InputError: the cell has no arms.
            StorageError: the meshes cannot be written.
        """
        from twinct.robots.cell import cell_urdf

        return cell_urdf(self.cell if meshes is None else self.room, self._optical, meshes)

    @property
    def _optical(self) -> Pose:
        """Frame of the camera in the panel's, at the first view's source."""
        source, detector = PosePairs.from_geometry(self.requested)[0]
        to_source = detector.inverse().apply(source.position)
        return Pose.from_matrix(to_source, np.diag([1.0, -1.0, -1.0]))

    def moveit(self, meshes: Path) -> dict[str, str]:
        """Return the cell for MoveIt: text by the name of the file.

        Args:
            meshes: folder for the meshes that the robot description names.

        Raises:
            InputError: the cell has no arms.
            StorageError: the meshes cannot be written.
        """
        from twinct.robots.cell.moveit import moveit_files

        return moveit_files(self.room, self._optical, meshes)

    def cell_of(self, section: Cell) -> CellModel:
        """Return the operating room that another ``cell`` section describes.

        Fixed bodies may overlap: ``apart`` judges them.
        """
        return self._cell_with(self._obstacles, section=section)

    def rough_cell_of(self, section: Cell) -> CellModel:
        """Return the room of ``cell_of`` with a simpler specimen inside the real one.

        It is built several times faster, and holds every view that the real one holds.
        """
        return self._cell_with(self._rough_obstacles, section=section)

    @cached_property
    def _rough_obstacles(self) -> tuple[Trimesh, ...]:
        import trimesh

        directions = fibonacci_directions(ROUGH_DIRECTIONS)
        rough: list[Trimesh] = []
        for obstacle in self._obstacles:
            farthest = np.unique((directions @ obstacle.vertices.T).argmax(axis=1))
            rough.append(trimesh.Trimesh(obstacle.vertices[farthest]).convex_hull)
        return tuple(rough)

    def _cell_with(
        self,
        solids: tuple[Trimesh, ...],
        look: Trimesh | None = None,
        *,
        section: Cell | None = None,
    ) -> CellModel:
        """Return the room with convex bodies, or the hull of the look, that collide."""
        from twinct.robots.cell import build_cell

        room = section or self.scenario.cell
        if not isinstance(room, Cell):
            raise InputError(f"cell.kind: a {room.kind} has no arms to build")
        pose, panel = self.specimen.world_from_specimen, self.scenario.detector.panel
        look = joined(solids) if look is None else look
        return build_cell(room, look, pose, panel, solids=solids)

    @cached_property
    def plan(self) -> MotionPlan | None:
        """Joint configurations of all views; None for a gantry, which reaches any pose.

        Raises:
            InputError: the plan's file is invalid.
            TrajectoryError: views are out of reach, or would collide.
        """
        if self.given_plan or isinstance(self.scenario.cell, GantryCell):
            return self.given_plan
        from twinct.robots.motion import RequestedViews, checked_plan, load_plan, plan_motion

        scenario = self.scenario
        targets = targets_of(self.requested)
        if file := scenario.motion.plan:
            requested = RequestedViews(
                targets, self.roll_free, scenario.motion.order != "given", self.shutter
            )
            return checked_plan(load_plan(file), self.cell, scenario.motion, requested, str(file))
        return plan_motion(
            self.cell, scenario.motion, targets, roll_free=self.roll_free, shutter=self.shutter
        )

    @cached_property
    def gantry_gap(self) -> Gap | None:
        """Smallest gap of a gantry to the bodies of its room; None for arms, or without any.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            TrajectoryError: a gantry comes too near to a body, or a C-arm cannot hold a view.
        """
        scenario = self.scenario
        if not isinstance(scenario.cell, GantryCell):
            return None
        from twinct.robots.cell import require_free_way

        views = [(source, panel) for source, panel, *_ in self.commanded_poses]
        clearance = scenario.motion.clearance_mm
        place = self.specimen.world_from_specimen if scenario.cell.c_arm else None
        solids = self._obstacles if scenario.cell.c_arm else ()
        return require_free_way(
            scenario.cell, scenario.detector.panel, views, clearance, place, solids
        )

    @property
    def plan_digest(self) -> str:
        """SHA-256 of all that ``plan`` reads, as its key in a cache.

        Raises:
            TrajectoryError: the file of views cannot be read.
        """
        # The focal spot counts as far as it lets the source roll.
        read = json.dumps([plan_digest(self.scenario), self.roll_free])
        return hashlib.sha256(read.encode()).hexdigest()

    @property
    def shutter(self) -> Shutter:
        """Duration of an exposure, and least time from one image to the next."""
        from twinct.robots.motion import Shutter

        source, detector = self.scenario.source, self.scenario.detector
        return Shutter(
            source.exposure_ms / 1000,
            source.motion_samples,
            remember=detector.lag > 0,
            frame_s=(detector.frame_ms or 0.0) / 1000,
        )

    @property
    def followed(self) -> MotionPlan | None:
        """Motion plan that the arms follow; None if they solve each target as it comes."""
        return None if self.scenario.motion.scheme == "reactive" else self.plan

    def draw(
        self,
        path: str | Path,
        view: int,
        width: int = 1600,
        height: int = 1000,
        marks: Marks | None = None,
    ) -> None:
        """Write a picture (PNG) of the room at one view.

        Args:
            path: file to write.
            view: the view.
            width: pixels.
            height: pixels.
            marks: marks in addition to the cell.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            StorageError: the file cannot be written.
            TrajectoryError: views are out of reach, or would collide.
        """
        from twinct.robots.cell import build_gantry, paint_specimen, render_cell

        cell = self.scenario.cell
        if isinstance(cell, GantryCell):
            specimen, panel = self.specimen, self.scenario.detector.panel
            place, poses = specimen.world_from_specimen, self.commanded_poses[view]
            room = build_gantry(cell, specimen.surface(), place, panel, *poses)
            paint_specimen(room, specimen.colour)
            render_cell(room, Path(path), None, width, height, marks)
        else:
            assert self.plan is not None
            joints = self.plan.joints[view]
            render_cell(self.room, Path(path), joints, width, height, marks)

    @cached_property
    def true_cell(self) -> TrueCell | None:
        """Cell with its true deviations; None if the controllers' model has no errors."""
        scenario, chains = self.scenario, None
        if not scenario.uncertainty.moves:
            return None
        if scenario.cell.kind == "arms":
            from twinct.robots.cell import chains_of

            chains = chains_of(self.cell)
        return TrueCell(scenario.uncertainty, scenario.seed, scenario.arms_seed, chains)

    def robots(self, *, planned: bool = False) -> PursuingSimulation | Gantry:
        """Return a robot simulation at rest in the plan's home, or a gantry.

        ``planned``: the simulation will receive its plan later.
        """
        scenario, source, lags = self.scenario, self.scenario.source, self.scenario.detector.lag > 0
        if isinstance(scenario.cell, GantryCell):
            place = scenario.specimen.world_from_specimen
            return Gantry(scenario.cell, source, place, remember=lags, true_cell=self.true_cell)
        from twinct.robots.motion import PursuingSimulation

        plan = None if planned else self.plan
        return PursuingSimulation(
            self.cell, scenario.motion, plan, self.shutter, self._roll_free, self.true_cell
        )

    def imager(self) -> Imager:
        """Return an X-ray simulation of the specimen."""
        from twinct.xray import Imager

        scenario = self.scenario
        return Imager(
            scenario.source,
            scenario.detector,
            self.specimen,
            commanded=self.commanded,
            seed=scenario.seed,
            mas=self.mas,
            engine=scenario.xray.engine,
            objects=self.beam_objects,
        )


def _decide_cell(scenario: Scenario) -> object:
    """Return the sections that decide ``SimulationBuilder.cell``."""
    return scenario.cell, scenario.specimen, scenario.detector.panel
