"""Goals of planned views under a scenario's errors, without images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, Panel, Pose, ScanGeometry, lock
from twinct.robots.calibrated_arms import CalibratedArms
from twinct.runs.propagating import nominal_scan
from twinct.scan import SimulationBuilder
from twinct.scenario import Uncertainty
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.propagation import draw, project
from twinct.view_plans.task_goals import goals_of


@dataclass(frozen=True, eq=False)
class Rejudged:
    """Figure of a task's goal without and with errors.

    Attributes:
        commanded: figure of the planned views.
        drawn: figure of each drawn scan, (draws,).
    """

    commanded: float
    drawn: Floats

    def __post_init__(self) -> None:
        """Make the figures read-only."""
        lock(self, "drawn")


def rejudged(
    builder: SimulationBuilder, draws: int, progress: Progress = SILENT
) -> tuple[dict[str, Rejudged], Floats]:
    """Judge the views of a scenario by its task, under its errors.

    Goals are evaluated at the executed poses. Detectability is further reduced by the errors of the
    believed poses: images that disagree about the position of the region's centre blur the signal,
    like a Gaussian with their root mean square in each direction (``Detectability.blurred``).

    Penalties are relative to the scenario's views, as no other views are known here. With
    calibrated arms (``uncertainty.calibration``), all scans use this pair and its calibrated model;
    otherwise other arms are drawn for each scan.

    Args:
        builder: builder of a scenario with a task.
        draws: number of scans.
        progress: receives the progress.

    Returns:
        Each goal by its name; the blur of each scan, one sigma in each direction, (draws,), mm.

    Raises:
        InputError: no file of calibrated arms, or arms of another cell.
        TrajectoryError: a view is out of reach or would collide.
    """
    scenario = builder.scenario
    task = scenario.task
    assert task is not None
    scan, panel = nominal_scan(builder), scenario.detector.panel
    views = len(scan.time_s)
    seeds = scenario.seed, scenario.arms_seed
    true, believed = _drawn_poses(scenario.uncertainty, seeds, scan, draws)
    planned = _geometry(scan.poses[0], scan.poses[1], panel)
    executed = [_geometry(true[0, k], true[1, k], panel) for k in range(draws)]
    place = builder.specimen.world_from_specimen.apply(np.asarray(task.position_mm))
    blur = _blur_mm(true, believed, planned, place)
    dropped = {name: None for name, (one, _) in task.goals.items() if one.under_errors is None}
    moved = task.model_copy(update=dropped)
    quiet = SimulationBuilder(scenario.model_copy(update={"task": moved}))
    together = ScanGeometry.joined([planned, *executed])
    mas = builder.mas
    exposures = np.ones(views) if mas is None else mas / scenario.source.mas
    by_name: dict[str, Rejudged] = {}
    for goal in goals_of(quiet, together, views, range(views), progress):
        objective, section = task.goals[goal.name]
        assert objective.under_errors is not None
        planned_figure, *drawn = (
            objective.under_errors(
                section, goal.measure, range(k * views, (k + 1) * views), sigma, exposures
            )
            for k, sigma in enumerate([0.0, *blur.tolist()])
        )
        by_name[goal.name] = Rejudged(planned_figure, np.array(drawn))
    return by_name, blur


def _drawn_poses(
    uncertainty: Uncertainty, seeds: tuple[int, int], scan: NominalScan, draws: int
) -> tuple[Floats, Floats]:
    """Return true and believed poses of both tools in each draw, as ``draw`` does."""
    tool_model = None
    if file := uncertainty.calibration:
        source, detector = scan.chains
        tool_model = CalibratedArms.read(file, (source, detector)).tool
    parts = list(draw(uncertainty, scan, draws, *seeds, tool_model))
    true, believed = (
        np.concatenate([getattr(one, name) for _, one in parts], axis=2)
        for name in ("true", "believed")
    )
    return true, believed


def _geometry(sources: Floats, detectors: Floats, panel: Panel) -> ScanGeometry:
    """Return the geometry of poses given as matrices, (views, 4, 4)."""
    source, detector = (
        [Pose.from_matrix(one[:3, 3], one[:3, :3]) for one in side] for side in (sources, detectors)
    )
    return ScanGeometry.from_poses(source, detector, panel)


def _blur_mm(true: Floats, believed: Floats, planned: ScanGeometry, place: Floats) -> Floats:
    """Return the disagreement of images about a place, rms in each direction, (draws,), mm.

    Distances are measured at the place. A shift common to all images moves the place without blur;
    it is removed to first order.
    """
    panel = planned.panel
    around = place + np.vstack([np.zeros(3), np.eye(3)])
    pitch = np.array([panel.pitch_u, panel.pitch_v])
    shrink = np.linalg.norm(planned.source - place, axis=1) / planned.sdd_to_centre
    seen, believed_shift = (
        project(poses, panel, around) * pitch * shrink[:, None, None] for poses in (true, believed)
    )
    draws = seen.shape[0]
    off = (seen - believed_shift)[:, :, 0].reshape(draws, -1)
    slopes = np.moveaxis(believed_shift[:, :, 1:] - believed_shift[:, :, :1], 2, -1).reshape(
        draws, -1, 3
    )
    left: list[Floats] = [
        one - slope @ np.linalg.lstsq(slope, one, rcond=None)[0]
        for one, slope in zip(off, slopes, strict=True)
    ]
    return np.sqrt(np.square(np.array(left)).mean(axis=1))
