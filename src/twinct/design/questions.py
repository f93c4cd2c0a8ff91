"""Questions about a scenario, each answered by a call of the library.

A question is plain data, so that a worker process can answer it: ``question.answered(Bench())``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError, TrajectoryError
from twinct.design.bench import Bench
from twinct.geometry import Floats, ScanGeometry, fibonacci_directions
from twinct.runs.checking import check
from twinct.runs.needs import needs
from twinct.runs.reaching import orbit_of
from twinct.runs.remedies import requested_poses
from twinct.scenario import Cell, Scenario, ScenarioText

if TYPE_CHECKING:
    from twinct.recon.volume import Volume
    from twinct.robots.motion import MotionPlan

PREVIEW_PX = (160, 120)
"""Largest columns and rows of a preview."""

COARSE_DIRECTIONS, COARSE_ROLLS = 200, 2
"""Directions of the coarse shading, and rolls that are tried for each."""

TURN_RAD = 0.31
"""Turn about the vertical between one set of directions and the next, which lie in between."""

SMALL_VOXELS = 64
"""Voxels of a small volume along its longest axis."""

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Question:
    """A question about the scenario of a text.

    Attributes:
        source: the text.
    """

    source: ScenarioText
    subject: ClassVar[str]

    @staticmethod
    def reads(scenario: Scenario) -> object:
        """Return the parts of a scenario that decide the answer."""
        return scenario

    def answered(self, bench: Bench) -> Any:
        """Return the answer.

        Raises:
            InputError: the question has no answer; says why.
        """
        raise NotImplementedError


def _of_motion(scenario: Scenario) -> object:
    return (
        scenario.cell,
        scenario.motion,
        scenario.trajectory,
        scenario.specimen,
        scenario.detector.panel,
        scenario.source,
    )


@dataclass(frozen=True)
class HeldViews(Question):
    """Question for the views that both arms hold: the first verdict, without the ways between."""

    subject: ClassVar[str] = "views"
    reads = staticmethod(_of_motion)

    def answered(self, bench: Bench) -> NDArray[np.bool_]:
        """Return a flag for each view, (views,)."""
        from twinct.robots.reach import Holder

        scenario = bench.scenario(self.source)
        builder = bench.builder(scenario)
        if not isinstance(scenario.cell, Cell):
            return np.ones(len(builder.requested), bool)
        holder = Holder(builder.cell, scenario.motion, roll_free=builder.roll_free)
        return holder.held(requested_poses(builder))


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion through all views.

    Attributes:
        plan: the plan; None for a gantry, or if there is none.
        problems: why there is no plan.
        refused: views that the arms cannot hold, as far as known.
    """

    plan: MotionPlan | None
    problems: tuple[str, ...] = ()
    refused: tuple[int, ...] = ()

    @property
    def duration_s(self) -> float:
        """Duration of the plan, s; NaN without one."""
        return math.nan if self.plan is None else float(self.plan.duration_s)

    @property
    def clearance_mm(self) -> float:
        """Smallest gap of the plan, mm; NaN without one."""
        return math.nan if self.plan is None else float(self.plan.clearance_mm.min())


@dataclass(frozen=True)
class PlannedMotion(Question):
    """The motion through all views: reach, collisions, time and clearance."""

    subject: ClassVar[str] = "motion"
    reads = staticmethod(_of_motion)

    def answered(self, bench: Bench) -> Motion:
        """Return the plan, or why there is none."""
        try:
            return Motion(bench.builder(bench.scenario(self.source)).plan)
        except TrajectoryError as error:
            return Motion(None, tuple(error.problems), error.views)


@dataclass(frozen=True)
class Checked(Question):
    """The whole check of a run, with remedies for views out of reach."""

    subject: ClassVar[str] = "check"

    def answered(self, bench: Bench) -> Mapping[str, str]:
        """Return what ``twinct check`` finds, by topic."""
        found = check(bench.scenario(self.source))
        doubts = {f"warning {k}": text for k, text in enumerate(found.warnings, start=1)}
        return {**found.findings, **doubts}


@dataclass(frozen=True, eq=False)
class Shading:
    """Reach over the sphere of directions from the isocentre to the source.

    Attributes:
        isocentre_mm: middle of the sphere, (3,).
        sod_mm: radius.
        directions: unit vectors, (d, 3).
        both: directions that both arms hold at once, (d,).
        alone: directions that the source's and the panel's arm hold alone, (2, d).
    """

    isocentre_mm: Floats
    sod_mm: float
    directions: Floats
    both: NDArray[np.bool_]
    alone: NDArray[np.bool_]

    def with_(self, more: Shading) -> Shading:
        """Return the shading with further directions at the same radius."""
        return replace(
            self,
            directions=np.concatenate([self.directions, more.directions]),
            both=np.concatenate([self.both, more.both]),
            alone=np.concatenate([self.alone, more.alone], axis=1),
        )


def _of_sphere(scenario: Scenario) -> object:
    trajectory = scenario.trajectory
    distances = [getattr(trajectory, key, None) for key in ("isocentre_mm", "sod_mm", "sdd_mm")]
    path = trajectory if distances[1] is None else distances
    return scenario.cell, scenario.motion, path, scenario.specimen, scenario.detector.panel


@dataclass(frozen=True)
class ShadedSphere(Question):
    """Reach of both arms at this radius.

    Attributes:
        directions: number of directions.
        rolls: rolls about the beam that are tried; a few miss a direction now and then.
        known: shading of this scenario, to which the answer adds as many directions in between.
    """

    directions: int = COARSE_DIRECTIONS
    rolls: int = COARSE_ROLLS
    known: Shading | None = None
    subject: ClassVar[str] = "sphere"
    reads = staticmethod(_of_sphere)

    def answered(self, bench: Bench) -> Shading:
        """Return the shading.

        Raises:
            InputError: the cell is a gantry.
        """
        from twinct.robots.reach import Holder, poses_of

        scenario = bench.scenario(self.source)
        if not isinstance(scenario.cell, Cell):
            raise InputError(
                f"cell.kind: {scenario.cell.kind}: reaches every pose; reach needs arms"
            )
        builder = bench.builder(scenario)
        sod, odd, centre = orbit_of(builder)
        towards = fibonacci_directions(self.directions)
        if self.known is not None:
            turns = len(self.known.directions) / self.directions
            towards = Rotation.from_euler("z", turns * TURN_RAD).apply(towards)
        poses = poses_of(towards, sod, odd, centre, scenario.detector.panel)
        both, alone = Holder(builder.cell, scenario.motion, rolls=self.rolls).held_by(poses)
        found = Shading(np.asarray(centre), sod, towards, both, alone)
        return found if self.known is None else self.known.with_(found)


def preview(scenario: Scenario, largest: tuple[int, int] = PREVIEW_PX) -> Scenario:
    """Return a scenario with an ideal panel of the same size and few pixels."""
    panel = scenario.detector.panel
    columns = min(panel.columns, largest[0])
    rows = min(panel.rows, largest[1])
    width, height = panel.size_mm
    pitch = [width / columns, height / rows]
    detector = {"columns": columns, "rows": rows, "pixel_pitch_mm": pitch}
    return scenario.with_({"detector": detector})


@dataclass(frozen=True)
class Projection(Question):
    """The image of one view.

    Attributes:
        view: index of the view.
        whole: all pixels, with noise and scatter; else few and ideal ones.
    """

    view: int = 0
    whole: bool = False
    subject: ClassVar[str] = "image"

    @staticmethod
    def reads(scenario: Scenario) -> object:
        """Return the sections that decide the image."""
        return (
            scenario.specimen,
            scenario.source,
            scenario.detector,
            scenario.xray,
            scenario.trajectory,
            scenario.cell.keyed_objects,
        )

    def answered(self, bench: Bench) -> Image:
        """Return the transmission in the commanded geometry, (rows, columns)."""
        scenario = bench.scenario(self.source)
        builder = bench.builder(scenario if self.whole else preview(scenario))
        views: ScanGeometry = builder.requested
        view = min(self.view, len(views) - 1)
        place = builder.specimen.world_from_specimen
        return bench.imager(builder).render(views[view], place, view)


@dataclass(frozen=True)
class Costs:
    """Resources of a scan.

    Attributes:
        views: number of views.
        exposure_s: exposure of all views, s.
        memory_bytes: largest memory of a stage.
        disk_bytes: size of the run's folder.
        reconstruction_bytes: memory of the reconstruction.
        reconstruction_s: expected time of the reconstruction, s; NaN unless small scans of this
            kind were timed on this machine.
    """

    views: int
    exposure_s: float
    memory_bytes: int
    disk_bytes: int
    reconstruction_bytes: int
    reconstruction_s: float


@dataclass(frozen=True)
class ScanCosts(Question):
    """Exposure, memory and disk space of a run."""

    subject: ClassVar[str] = "costs"

    def answered(self, bench: Bench) -> Costs:
        """Return the costs."""
        scenario = bench.scenario(self.source)
        views = len(bench.builder(scenario).requested)
        stages = needs(scenario, "local")
        reconstruction = stages["reconstruction"]
        seconds = reconstruction.seconds
        return Costs(
            views,
            views * scenario.source.exposure_ms / 1000,
            max(stage.memory_bytes for stage in stages.values()),
            sum(stage.disk_bytes for stage in stages.values()),
            reconstruction.memory_bytes,
            math.nan if seconds is None else seconds,
        )


@dataclass(frozen=True)
class MeasuredTime(Question):
    """The time of a run by small scans on this machine, which ``ScanCosts`` then knows."""

    subject: ClassVar[str] = "time"

    def answered(self, bench: Bench) -> str:
        """Return the time of the whole run, in words.

        Raises:
            InputError: a small scan fails.
        """
        from twinct.runs.pilot import measured_time

        bench.close()  # gVXR is a scene of the process
        found = measured_time(bench.scenario(self.source), "local")
        if found is None:
            raise InputError("a small scan fails, such as by a view that is out of reach")
        return found.in_words


@dataclass(frozen=True, eq=False)
class Volumes:
    """A small volume, beside the truth on its grid."""

    volume: Volume
    truth: Volume


def small(scenario: Scenario, voxels: int = SMALL_VOXELS) -> Scenario:
    """Return a scenario whose volume takes seconds: few voxels and pixels, and no arms that move.

    Views, specimen, source, and errors of views and patient stay. The algorithm is ``fast``.
    """
    from twinct.scenario import parse_scenario

    data = preview(scenario).model_dump(mode="json")
    grid = scenario.reconstruction.volume_grid
    edge = float(np.max(grid.size_mm)) / voxels
    counts = [max(2, round(size / edge)) for size in grid.size_mm]
    section = {"voxels": counts, "voxel_mm": edge, **_place(scenario)}
    data["reconstruction"] = {"algorithm": "fast", "grid": section}
    if isinstance(scenario.cell, Cell):
        data |= {"cell": {"kind": "gantry"}, "motion": {}}
        data["uncertainty"].pop("arms", None)
    return parse_scenario(data | {"task": None, "evaluation": None})


def _place(scenario: Scenario) -> dict[str, Any]:
    section = scenario.reconstruction
    centre = section.grid.centre_mm if section.zoom is None else section.zoom.centre_mm
    return {"centre_mm": list(centre), "rotation_deg": list(section.grid.rotation_deg)}


@dataclass(frozen=True)
class SmallVolume(Question):
    """A reconstruction in seconds, beside the truth.

    Attributes:
        voxels: voxels along the longest axis.
    """

    voxels: int = SMALL_VOXELS
    subject: ClassVar[str] = "volume"

    def answered(self, bench: Bench) -> Volumes:
        """Return both volumes."""
        from twinct.recon.volume import Volume
        from twinct.runs import reconstruct, simulate, truth_of

        bench.close()
        builder = bench.builder(small(bench.scenario(self.source), self.voxels))
        scan = simulate(builder.scenario, builder=builder)
        volume = reconstruct(scan)
        return Volumes(volume, Volume(truth_of(scan, builder).volume, volume.grid))
