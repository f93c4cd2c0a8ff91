"""From scenario to scan to volume to figures, in memory or on disk.

``simulate`` and ``reconstruct`` serve a notebook. The command line takes the same steps and keeps
each on disk: ``acquire_to_store`` and ``reconstruct`` with a folder for checkpoints.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError, MissingExtraError, TrajectoryError
from twinct.evaluate import ImageFigures, image_figures, region_of_interest, sight
from twinct.extras import require
from twinct.geometry import Pose, ScanGeometry
from twinct.hardening import check_hardening, effective_energy
from twinct.reconstruction import (
    SILENT,
    Progress,
    line_integrals,
    reconstruct,
    reconstruction_digest,
    require_feasible,
)
from twinct.scan import LocalRig, Rig, Scan, ScanStore, Stopwatch, View, Workshop, acquire
from twinct.scenario import Scenario
from twinct.views import Instant, Reached

if TYPE_CHECKING:
    from twinct.xray.chain import Frame

__all__ = [
    "SILENT",
    "Progress",
    "Truth",
    "acquire_to_store",
    "check_physics",
    "check_sight",
    "effective_energy",
    "judge",
    "line_integrals",
    "local_rig",
    "machine_frames",
    "mean_pose",
    "reconstruct",
    "reconstruction_digest",
    "require_extras",
    "require_feasible",
    "scenario_as_data",
    "simulate",
    "truth_of",
]

log = logging.getLogger(__name__)


def simulate(
    scenario: Scenario, *, workshop: Workshop | None = None, progress: Progress = SILENT
) -> Scan:
    """Plan, move and expose every view in this process, without files and without ROS.

    Args:
        scenario: what to scan and how.
        workshop: parts already built of this scenario.
        progress: told of each view.

    Raises:
        InputError: a file or material of the source or the detector that cannot be used.
        TrajectoryError: views that cannot be reached, or would collide; before anything moves.
        MotionError: the arms did not arrive.
    """
    workshop = workshop or Workshop(scenario)
    check_physics(workshop)
    views: list[View] = []
    names: tuple[str, ...] = ()
    with local_rig(workshop) as rig, progress.stage("views", len(workshop.targets)) as step:

        def keep(_: int, view: View, reached: Reached) -> None:
            nonlocal names
            names = reached.joint_names
            views.append(view)
            step()

        acquire(rig, scenario, workshop.targets, keep)
    return Scan.from_views(scenario, workshop.commanded_poses, names, views)


def local_rig(workshop: Workshop, start_state: NDArray[np.float64] | None = None) -> LocalRig:
    """Both simulations in this process, at home or in a state they had before."""
    robots = workshop.robots()
    if start_state is not None:
        robots.restore(start_state)
    return LocalRig(robots, workshop.imager(), workshop.scenario.detector.panel)


def acquire_to_store(
    workshop: Workshop,
    path: Path,
    make_rig: Callable[[int, NDArray[np.float64] | None], Rig],
    *,
    resume: bool,
    watch: Stopwatch | None = None,
    progress: Progress = SILENT,
) -> ScanStore:
    """Take the views that the store lacks; each is on disk before the next is requested.

    Args:
        workshop: the scenario's parts.
        path: the store.
        make_rig: gives a rig for the first view to take and the simulator state before it.
        resume: go on with a store that is there.
        watch: counts the seconds of this call.
        progress: told of each view.

    Raises:
        ScanExistsError: there is a scan and ``resume`` is false, or it is another scenario's.
    """
    scenario, targets = workshop.scenario, workshop.targets
    store = ScanStore.resume(path, scenario) if resume and path.exists() else None
    first = store.acquired if store else 0
    if store and first == len(targets):
        return store
    state = store.state(first - 1) if store and first else None
    with (
        closing(make_rig(first, state)) as rig,
        progress.stage("views", len(targets), first) as step,
    ):

        def keep(index: int, view: View, reached: Reached) -> None:
            nonlocal store
            if store is None:
                store = ScanStore.create(
                    path, scenario, workshop.commanded_poses, reached.joint_names, len(view.state)
                )
            store.write(index, view)
            log.info(
                "view %d: t %.3f s, clearance %.1f mm",
                index,
                view.simulated_s,
                view.clearance_mm,
            )
            step()

        acquire(rig, scenario, targets, keep, first=first, watch=watch)
    assert store is not None
    return store


def machine_frames(scan: Scan, workshop: Workshop, views: Iterable[int]) -> Iterator[Frame]:
    """Raw, flat and dark images of views of a scan, rendered again from the executed poses.

    A scan stores transmission only; these are the images that it came from, to the last bit.

    Args:
        scan: with its executed poses.
        workshop: the scenario's parts.
        views: their indices.

    Raises:
        InputError: an ideal source and detector, which have no such images; or lag together with
            motion blur, for which the scan does not hold where the last exposure ended.
    """
    source, detector = scan.scenario.source, scan.scenario.detector
    if source.ideal and detector.ideal:
        raise InputError("an ideal source and detector have no raw images: set detector.readout")
    if detector.lag and scan.exposure is not None:
        raise InputError("raw images with detector.lag and source.motion_samples cannot be redone")
    geometry = scan.executed.geometry(detector.panel)

    def instant(view: int) -> tuple[ScanGeometry, Pose]:
        return geometry[view], scan.executed_object[view]

    with workshop.imager() as imager:
        for view in views:
            path = [instant(view)]
            if scan.exposure is not None:
                triples = (
                    Instant(*map(tuple, numbers)) for numbers in scan.exposure[view].tolist()
                )
                path = [triple.placed(detector.panel) for triple in triples]
            before = instant(view - 1) if detector.lag and view else None
            yield imager.frame(path, view, before)


@dataclass(frozen=True, eq=False)
class Truth:
    """What a reconstruction is judged against.

    Attributes:
        volume: attenuation of the specimen, (z, y, x), 1/mm, float32.
        region: voxels that every view sees, (z, y, x), bool.
        mu_reference: attenuation to which figures are relative, 1/mm.
    """

    volume: NDArray[np.float32]
    region: NDArray[np.bool_]
    mu_reference: float


def truth_of(scan: Scan, workshop: Workshop, progress: Progress = SILENT) -> Truth:
    """The truth of a scan, where the specimen really was, and the region every view sees."""
    scenario = scan.scenario
    grid = scenario.reconstruction.grid.volume_grid
    energy = effective_energy(scenario)
    with progress.stage("truth", 2) as step:
        volume = workshop.specimen.truth(grid, energy, mean_pose(scan.executed_object))
        step()
        region = region_of_interest(scan.executed.geometry(scenario.detector.panel), grid)
        step()
    return Truth(volume, region, workshop.specimen.reference_mu(energy))


def mean_pose(poses: tuple[Pose, ...]) -> Pose:
    """The pose halfway: the specimen stands still, so any view's would do but for rounding."""
    return poses[len(poses) // 2]


def judge(scan: Scan, volume: NDArray[np.float32], truth: Truth) -> ImageFigures:
    """The image figures of a reconstruction."""
    return image_figures(
        volume,
        truth.volume,
        truth.region,
        truth.mu_reference,
        scan.scenario.reconstruction.grid.volume_grid,
    )


def check_sight(workshop: Workshop) -> list[str]:
    """Make sure that the commanded views see the specimen, before anything is planned.

    Returns:
        What a user should know of a scan that can be run.

    Raises:
        TrajectoryError: no view sees the specimen, it stands behind a panel, or no voxel is seen by
            every view, so that nothing could be judged.
    """
    place = workshop.specimen.world_from_specimen
    grid = workshop.scenario.reconstruction.grid.volume_grid
    seen = sight(workshop.commanded, place.apply(workshop.hull.vertices), grid)
    x, y, z = place.position
    where = f"the specimen at ({x:g}, {y:g}, {z:g}) mm (specimen.position_mm)"
    problems = []
    if seen.from_behind:
        problems.append(
            f"{_views(seen.from_behind)}: {where} reaches behind the panel: the image would show "
            "what lies there; move the specimen, or take a longer sdd_mm"
        )
    elif len(seen.blind) == seen.views:
        problems.append(
            f"no view sees {where}: all its shadows miss the panel; move the specimen, or the "
            "isocentre of the trajectory"
        )
    if seen.region_empty:
        problems.append(
            "no voxel of the grid is seen by every view, so the image cannot be judged: move the "
            "grid into the beam (reconstruction.grid.centre_mm), or use a larger panel or a "
            "smaller orbit"
        )
    if problems:
        raise TrajectoryError(problems)
    warnings = []
    if seen.blind:
        warnings.append(f"{_views(seen.blind)} of {seen.views} in all see nothing of {where}")
    if not seen.in_region:
        warnings.append(
            f"{where} lies outside the voxels that every view sees: the image figures will say "
            "nothing of it"
        )
    return warnings


def _views(views: tuple[int, ...]) -> str:
    few = ", ".join(map(str, views[:8])) + (", ..." if len(views) > 8 else "")
    return f"view {few}" if len(views) == 1 else f"{len(views)} views ({few})"


def check_physics(workshop: Workshop) -> None:
    """Make sure that source, detector and corrections can be built, before any other work.

    Raises:
        InputError: every file, material or number that cannot be used, each with its key.
        MissingExtraError: SpekPy is needed and not installed.
    """
    from twinct.xray.check import check_parts

    scenario = workshop.scenario
    problems: list[str] = []
    for check in (
        lambda: check_parts(scenario.source, scenario.detector, workshop.commanded, scenario.seed),
        lambda: check_hardening(scenario),
    ):
        try:
            check()
        except MissingExtraError:
            raise
        except InputError as error:
            problems += error.problems
    if problems:  # both need the spectrum, and may say the same of it
        raise InputError(dict.fromkeys(problems))


def require_extras(scenario: Scenario) -> None:
    """Refuse before any work what is not installed.

    Raises:
        InputError: naming the extra that brings it.
    """
    require("robots", "xray", *(["rtk"] if scenario.reconstruction.engine == "rtk" else []))


def scenario_as_data(scenario: Scenario) -> object:
    """The resolved scenario as plain data, defaults included."""
    return json.loads(scenario.resolved())
