"""Checks before any work: extras, physics, and visibility of the specimen in the views."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twinct.core import card
from twinct.core.errors import (
    InputError,
    MissingExtraError,
    TargetRefusedError,
    TrajectoryError,
)
from twinct.core.extras import require
from twinct.core.foreign_text import quoted
from twinct.core.progress import SILENT, Progress
from twinct.evaluation import sight
from twinct.recon.engine import requested_engine
from twinct.recon.moving import refuse_card
from twinct.report import physics_in_words
from twinct.robots.c_arm import CArmKinematics
from twinct.runs.integrals import check_hardening
from twinct.runs.metal_reduction import check_metal
from twinct.runs.on_table import larger_than_table
from twinct.runs.regions import Places
from twinct.runs.repeated_figures import check_repeats
from twinct.runs.scatter_correction import check_scatter_correction
from twinct.runs.slips import doubted_lengths, doubted_times
from twinct.scan import OWN, RELATIVE, SimulationBuilder, named_geometries
from twinct.scenario import Scenario, stage_digests
from twinct.scenario.imported import ScanSettings
from twinct.specimen.convex_parts import Fit
from twinct.specimen.room_bodies import convex_pieces, object_in_words
from twinct.specimen.size import SpecimenSize, specimen_size
from twinct.trajectory import ends_of_sweeps
from twinct.xray.build import build_spectrum
from twinct.xray.check import check_parts
from twinct.xray.engines import engine_extras, engine_named

MOST_CUT = 0.01
"""Share of a view's rays that may cross a cut face of a CT without a warning."""
if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan


def check_sight(builder: SimulationBuilder) -> list[str]:
    """Check that the views see the specimen, and return warnings for the user.

    Raises:
        TrajectoryError: no view sees the specimen, it reaches behind a panel, or no voxel is seen,
            so that the volume could not be judged.
        InputError: see ``check_places``.
        SpecimenError: an object of the room has an unknown material or an unusable mesh.
    """
    place = builder.specimen.world_from_specimen
    grid = builder.scenario.reconstruction.volume_grid
    seen = sight(builder.commanded, place.apply(builder.hull.vertices), grid)
    x, y, z = place.position
    where = f"the specimen at ({x:g}, {y:g}, {z:g}) mm (specimen.position_mm)"
    problems: list[str] = []
    if seen.from_behind:
        problems.append(
            f"{_views(seen.from_behind)}: {where} reaches behind the panel, and the image would "
            "show that part too; move the specimen, or use a larger sdd_mm"
        )
    elif len(seen.blind) == seen.views:
        problems.append(
            f"no view sees {where}: all its shadows miss the panel; move the specimen, or the "
            "isocentre of the trajectory"
        )
    if not seen.needed:
        problems.append(
            "no voxel of the grid is seen by a view, so the image cannot be judged: move the "
            "grid into the beam (reconstruction.grid.centre_mm), or use a larger panel or a "
            "smaller orbit"
        )
    size, middle = _size(builder), grid.world_from_grid.position
    to_middle_mm = float(builder.commanded.depth(middle).min())
    doubts = doubted_lengths(builder.scenario, size, to_middle_mm)
    if problems:
        raise TrajectoryError([*problems, *doubts])
    check_places(builder)
    _ = builder.beam_objects  # names unknown materials before anything moves
    warnings: list[str] = []
    if seen.blind:
        warnings.append(f"{where} is not visible in {_views(seen.blind)}, of {seen.views} in all")
    # A doubted panel or grid explains why parts seem too large or too small.
    warnings += doubts or size.warnings
    warnings += doubted_times(builder.scenario)
    warnings += _cut(builder)
    warnings += larger_than_table(builder)
    if seen.needed < seen.views:
        warnings.append(
            f"no voxel of the grid is seen by every view: the volume is judged in the voxels that "
            f"at least {seen.needed} of {seen.views} views see"
        )
    if not seen.in_region:
        warnings.append(
            f"{where} lies outside the voxels that are judged: the image figures will not cover it"
        )
    return warnings


def check_places(builder: SimulationBuilder) -> None:
    """Check that all regions and bodies of the section ``evaluation`` can be measured.

    Raises:
        InputError: regions without a voxel, bodies that are too small, or figures of a scan that
            cannot be taken again, each with its key.
    """
    scenario = builder.scenario
    if scenario.evaluation is None:
        return
    check_repeats(scenario)
    specimen, grid = builder.specimen, scenario.reconstruction.volume_grid
    if problems := Places(scenario, specimen, specimen.world_from_specimen, grid).check():
        raise InputError(problems)


def _size(builder: SimulationBuilder) -> SpecimenSize:
    scenario = builder.scenario
    grid = scenario.reconstruction.volume_grid
    return specimen_size(scenario.specimen, builder.specimen, builder.commanded, grid)


def _cut(builder: SimulationBuilder) -> list[str]:
    """Return a warning for each part that the edge of its CT cuts within the views."""
    specimen, warnings = builder.specimen, list[str]()
    seen = specimen.world_from_specimen.inverse() @ builder.commanded
    for part in specimen.parts:
        shares = part.cut_share(seen)
        views = tuple(np.flatnonzero(shares > MOST_CUT).tolist())
        if views:
            faces = ", ".join(face.name for face in part.cuts)
            warnings.append(
                f"part {quoted(part.name)}: its CT cuts the body ({faces}); in {_views(views)} up "
                f"to {100 * shares.max():.0f} % of its rays cross the cut, where tissue is "
                "missing; shape.extend_mm repeats the slices at both ends"
            )
    return warnings


def _views(views: tuple[int, ...]) -> str:
    few = ", ".join(map(str, views[:8])) + (", ..." if len(views) > 8 else "")
    return f"view {few}" if len(views) == 1 else f"{len(views)} views ({few})"


def check_physics(builder: SimulationBuilder) -> None:
    """Check that source, detector, corrections and errors can be built, before any other work.

    Raises:
        InputError: every file, material or number that cannot be used, each with its key.
        MissingExtraError: SpekPy is needed and not installed.
        TrajectoryError: a gantry would collide with an object of its room.
    """
    scenario = builder.scenario
    _check_all(
        lambda: check_parts(scenario.source, scenario.detector, builder.commanded, scenario.seed),
        lambda: check_corrections(scenario),
        lambda: _check_scatter(builder),
        lambda: _check_errors(builder),
    )
    _ = builder.gantry_gap


def _check_scatter(builder: SimulationBuilder) -> None:
    """Check that scatter can be simulated."""
    scenario = builder.scenario
    if (settings := scenario.detector.scatter) is not None:
        from twinct.xray.monte_carlo_scatter import check_scatter

        check_scatter(settings, builder.specimen, build_spectrum(scenario.source))


def _check_errors(builder: SimulationBuilder) -> None:
    """Check the errors of a gantry; those of arms are drawn in the rehearsal of their motion."""
    if builder.scenario.cell.kind == "gantry" and builder.true_cell is not None:
        builder.true_cell.check(builder.commanded)


def check_corrections(settings: ScanSettings) -> None:
    """Check that scatter, beam hardening and metal can be corrected, before any other work.

    Raises:
        InputError: every file, material or number that cannot be used, each with its key.
    """
    _check_all(
        lambda: check_scatter_correction(settings),
        lambda: check_hardening(settings),
        lambda: check_metal(settings),
    )


def _check_all(*checks: Callable[[], object]) -> None:
    problems: list[str] = []
    for check in checks:
        try:
            check()
        except MissingExtraError:
            raise
        except InputError as error:
            problems += error.problems
    if problems:  # several checks need the spectrum and may report the same problem
        raise InputError(dict.fromkeys(problems))


def findings(builder: SimulationBuilder) -> dict[str, str]:
    """Plan a scenario and describe it in words, by topic.

    Raises:
        TrajectoryError: a view is out of reach or would collide.
    """
    scenario, plan = builder.scenario, builder.plan
    grid = scenario.reconstruction.volume_grid
    physics = physics_in_words(scenario, *builder.commanded_poses[0], builder.mas)
    if plan is None:
        clearance = {"motion": machine_in_words(builder)}
        if gap := builder.gantry_gap:
            clearance["smallest clearance"] = (
                f"{gap.distance_mm:.1f} mm, between {' and '.join(gap.bodies)}"
            )
    else:
        worst = int(plan.clearance_mm.argmin())
        clearance = {} if builder.followed is None else {"motion": _duration(builder, plan)}
        clearance |= {
            "smallest clearance": f"{plan.clearance_mm.min():.1f} mm, "
            f"at view {worst}, between {' and '.join(plan.nearest[worst])}"
        }
    if scenario.cell.kind == "arms" and builder.cell.notes:
        clearance["arms, supplied or changed"] = "; ".join(builder.cell.notes)
    if scenario.cell.kind == "arms" and (fits := _fits(builder)):
        clearance["shapes that collide"] = "; ".join(f"{n}: {fit.words}" for n, fit in fits.items())
    parts = (f"{part.name} of {part.in_words}" for part in builder.specimen.parts)
    return {
        "views": _views_in_words(builder),
        **{name.lower(): words for name, words in physics.items()},
        "specimen": ", ".join(parts),
        "specimen size": str(_size(builder)),
        **clearance,
        "grid": f"{' x '.join(map(str, grid.shape_xyz))} voxels of "
        f"{' x '.join(f'{edge:g}' for edge in grid.voxel)} mm",
        "reconstruction": scenario.reconstruction.in_words,
        "digest": stage_digests(scenario)["images"],
    }


def _views_in_words(builder: SimulationBuilder) -> str:
    """Return number and kind of the views, with the sweeps of a scan that may end early."""
    views, kind, until = (
        len(builder.targets),
        builder.scenario.trajectory.kind,
        builder.scenario.until,
    )
    if until is None:
        return f"{views}, {kind}"
    ends = ", ".join(map(str, ends_of_sweeps(views, until.first)))
    return (
        f"at most {views}, {kind}; in sweeps that end after {ends}, until twice as many views "
        f"change the volume by less than {100 * until.change_rel:g} %"
    )


def machine_in_words(builder: SimulationBuilder) -> str:
    """Return the machine without arms, with the range of its joints if it is a C-arm."""
    cell = builder.scenario.cell
    if cell.kind == "arms" or cell.c_arm is None:
        return "a gantry, exactly at its commanded poses"
    views = [(source, panel) for source, panel, *_ in builder.commanded_poses]
    joints = CArmKinematics(cell.c_arm).joints(views)
    rotation, orbit = np.degrees(joints[:, :2]).T
    lift = joints[:, 2]
    return (
        f"a C-arm: rotation {rotation.min():.1f} to {rotation.max():.1f} deg, orbit "
        f"{orbit.min():.1f} to {orbit.max():.1f} deg, lift {lift.min():.1f} to {lift.max():.1f} mm"
    )


def _fits(builder: SimulationBuilder) -> dict[str, Fit]:
    """Return how closely convex bodies hold skins, objects and tools that are meshes, by name."""
    cell = builder.scenario.cell
    meshes = {
        one.name: convex_pieces(one.shape, object_in_words(one, key)).fit
        for key, one in cell.keyed_objects
        if one.shape.kind == "mesh" and one.collides
    }
    tools = {
        key: convex_pieces(part.shape, key).fit
        for keyed, tool in cell.keyed_tools
        for index, part in enumerate(tool.parts)
        for key in (f"{keyed}.parts.{index}",)
        if part.shape.kind == "mesh"
    }
    return builder.specimen.skin_fits | meshes | tools


LIMITS = 3
"""Largest number of limits of the scan time that are named."""

NAMED_SHARE = 0.05
"""Share of the scan time from which a limit is named."""


def _duration(builder: SimulationBuilder, plan: MotionPlan) -> str:
    """Describe the duration of a plan, and the limits that determine it."""
    from twinct.robots.motion import limiting  # 50 ms

    shares = limiting(plan, builder.cell, builder.scenario.motion, builder.shutter)
    named = [
        f"{key} ({100 * share:.0f} %)" for key, share in shares.items() if share >= NAMED_SHARE
    ]
    return f"{plan.duration_s:.1f} s, planned; limited by {', '.join(named[:LIMITS])}"


def rehearse(builder: SimulationBuilder, progress: Progress = SILENT) -> None:
    """Simulate the arms' motion of a scan without images, to find views that would be missed.

    Args:
        builder: simulations of the scan.
        progress: progress display.

    Raises:
        TrajectoryError: a view is missed; the message names the cause.
    """
    if builder.scenario.cell.kind != "arms":
        return
    robots = builder.robots()
    try:
        with progress.stage("rehearsal of the motion", len(builder.targets)) as step:
            for view, target in enumerate(builder.targets):
                robots.move(view, target)
                step()
    except TargetRefusedError as error:
        raise TrajectoryError(str(error)) from None
    finally:
        robots.close()


def check_geometries(scenario: Scenario, derived: Path | None = None) -> None:
    """Raise if a scenario reconstructs from a geometry that its scan cannot have.

    Args:
        scenario: scenario to be run.
        derived: folder of the geometries derived from its scan, if a scan exists.

    Raises:
        InputError: a geometry that is neither common to all scans nor in the folder.
    """
    known = (*OWN, RELATIVE, *(named_geometries(derived) if derived else ()))
    others = [name for name in scenario.reconstruction.geometries if name not in known]
    if others:
        raise InputError(
            f"reconstruction.geometry: unknown geometry {quoted(others[0])}; choose from "
            f"{', '.join(known)}; 'twinct geometry DIR --as NAME' derives one from a finished scan"
        )


def require_extras(scenario: Scenario) -> None:
    """Raise unless the extras that a scenario needs are installed.

    Raises:
        InputError: a package is missing; names the extra that provides it. Or the X-ray engine is
            unknown or cannot be used.
    """
    cell = scenario.cell
    obstacles = any(one.collides for _, one in cell.keyed_objects)
    needed = cell.kind == "arms" or obstacles or cell.c_arm is not None
    robots = ["robots"] if needed else []
    rtk = ["rtk"] if scenario.reconstruction.algorithm == "rtk_sart" else []
    require(*robots, *engine_extras(scenario.engine), *rtk)
    if scenario.engine is not None:
        engine_named(scenario.engine).check()


def check_engine(settings: ScanSettings) -> None:
    """Check the engine of the reconstruction that the environment names.

    Raises:
        InputError: it is unknown, there is no card for it, or it cannot do this job.
    """
    if requested_engine() != "cuda" or settings.reconstruction.algorithm == "rtk_sart":
        return
    card.device()
    motion = settings.reconstruction.motion
    if motion is not None and motion.compensate:
        refuse_card()
