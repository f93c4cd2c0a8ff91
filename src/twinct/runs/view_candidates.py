"""Views that a plan may choose from: all over the sphere, and those that the arms can have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.geometry import Floats, ScanGeometry
from twinct.progress import Progress
from twinct.scan import Workshop
from twinct.scenario import Cell, Scenario
from twinct.trajectory import OrbitSettings, UniformTrajectory, commanded_views


def orbit_of(scenario: Scenario) -> OrbitSettings:
    """The scenario's path.

    Raises:
        InputError: it is none about an isocentre.
    """
    section = scenario.trajectory
    if not isinstance(section, OrbitSettings):
        raise InputError(
            f"trajectory.kind: {section.kind}: candidates need an isocentre and distances: take a "
            "kind that has them, such as sinusoid"
        )
    return section


def candidates_of(scenario: Scenario) -> ScanGeometry:
    """Views all over the sphere, at the distances of the scenario's path."""
    orbit, task = orbit_of(scenario), scenario.task
    assert task is not None
    section = UniformTrajectory(
        kind="uniform",
        views=task.candidates,
        isocentre_mm=orbit.isocentre_mm,
        sod_mm=float(orbit.sod_at(0.5)),
        sdd_mm=float(orbit.sdd_at(0.5)),
        latitude_range_deg=(-90.0, 90.0),
    )
    return commanded_views(section, scenario.detector.panel)


def own_path(scenario: Scenario, views: int) -> ScanGeometry:
    """The scenario's path with another number of views."""
    section = orbit_of(scenario).model_copy(update={"views": views})
    return commanded_views(section, scenario.detector.panel)


def reachable(workshop: Workshop, geometry: ScanGeometry, progress: Progress) -> NDArray[np.intp]:
    """Candidates that both arms can hold at a time, with the clearance that a way keeps."""
    if not isinstance(workshop.scenario.cell, Cell):
        return np.arange(len(geometry))
    from twinct.reach import Holder, Poses

    holder = Holder(workshop.cell, workshop.scenario.motion, roll_free=workshop.roll_free)
    poses = Poses.of(geometry.source_poses(), geometry.detector_poses())
    of_arms = [holder.alone(side, arm) for arm, side in enumerate((poses.source, poses.detector))]
    alone = set(of_arms[0].pose.tolist()) & set(of_arms[1].pose.tolist())
    found: list[int] = []
    with progress.stage("views within reach", len(alone)) as step:
        for view in sorted(alone):
            if len(holder.pairs(of_arms[0], of_arms[1], view)):
                found.append(view)
            step()
    return np.array(found, np.intp)


def spread_evenly(sources: Floats, number: int) -> list[int]:
    """Views spread evenly: each the farthest from those before (Gonzalez 1985)."""
    chosen = [0]
    far = np.linalg.norm(sources - sources[0], axis=1)
    while len(chosen) < number:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(sources - sources[chosen[-1]], axis=1))
    return chosen
