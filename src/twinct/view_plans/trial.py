"""Simulated trials of planned views and of the scenario's path: images, volumes, errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.progress import Progress
from twinct.geometry import Floats, Pose, ScanGeometry, VolumeGrid
from twinct.runs.acquisition import acquire_to_store
from twinct.runs.truth import truth_of
from twinct.runs.volumes import reconstruct
from twinct.scan import SimulationBuilder, local_rig
from twinct.scenario import Scenario, ViewTask, parse_scenario
from twinct.trajectory import write_views
from twinct.view_plans.trial_picture import draw_tried

FOLDER, PICTURE = "tried", "tried.png"


@dataclass(frozen=True, eq=False)
class TrialVolume:
    """Result of a set of views.

    Attributes:
        error_rel: root mean square error in the task's region, relative to the reference's
            attenuation.
        volume: reconstruction of the views, (z, y, x).
        truth: true volume, (z, y, x).
    """

    error_rel: float
    volume: NDArray[np.float32]
    truth: NDArray[np.float32]


def trial(
    builder: SimulationBuilder, geometry: ScanGeometry, mas: Floats | None, folder: Path, name: str
) -> TrialVolume:
    """Simulate images of views as by a gantry, and reconstruct them as the scenario states.

    Args:
        builder: builder of a scenario with a task; its specimen is built once for all trials.
        geometry: the views.
        mas: mAs of each view, (views,); None: the source's.
        folder: folder of the scan, from which a later call continues.
        name: name of the scan.
    """
    scenario = builder.scenario
    assert scenario.task is not None
    grid, stands = scenario.reconstruction.volume_grid, scenario.specimen.world_from_specimen
    region, _ = _region(scenario.task, stands, grid)
    file, store = (folder / f"{name}{ending}" for ending in (".csv", ".zarr"))
    write_views(file, geometry, mas)
    moved = _of_gantry(scenario.model_dump(mode="json"), file)
    gantry = SimulationBuilder(moved, given_specimen=builder.specimen)
    scan = acquire_to_store(gantry, store, local_rig, resume=True).read()
    volume, truth = reconstruct(scan).array, truth_of(scan, gantry)
    off = volume[region].astype(float) - truth.volume[region]
    error = float(np.sqrt(np.mean(off**2))) / truth.mu_reference
    return TrialVolume(error, volume, truth.volume)


def tried(
    builder: SimulationBuilder,
    views: Mapping[str, tuple[ScanGeometry, Floats | None]],
    out: Path,
    progress: Progress,
) -> dict[str, float]:
    """Try sets of views, and draw the volumes side by side in ``PICTURE``.

    The scans are stored in ``FOLDER``, from which a later call continues.

    Args:
        builder: builder of a scenario with a task.
        views: the sets, by name, with the mAs of each view; None: the source's for all.
        out: folder that contains ``PICTURE`` and ``FOLDER``.
        progress: receives the progress.

    Returns:
        Root mean square error in the task's region, relative to the reference's attenuation, by
        name.
    """
    scenario = builder.scenario
    task = scenario.task
    assert task is not None
    (out / FOLDER).mkdir(exist_ok=True)
    trials: dict[str, TrialVolume] = {}
    with progress.stage("trying views", len(views)) as step:
        for name, (geometry, mas) in views.items():
            trials[name] = trial(builder, geometry, mas, out / FOLDER, name)
            step()
    shown = {"truth": next(iter(trials.values())).truth}
    for name, one in trials.items():
        shown[f"{name.replace('_', ' ')}, error {100 * one.error_rel:.1f} %"] = one.volume
    grid = scenario.reconstruction.volume_grid
    _, place = _region(task, scenario.specimen.world_from_specimen, grid)
    draw_tried(
        out / PICTURE,
        f"{scenario.name}: planned for the region in the circle",
        shown,
        grid.axes(),
        place,
        task.radius_mm,
    )
    return {name: one.error_rel for name, one in trials.items()}


def _region(
    task: ViewTask, world_from_specimen: Pose, grid: VolumeGrid
) -> tuple[NDArray[np.bool_], tuple[float, float, float]]:
    """Return the voxels of the task's region, (z, y, x), and its centre in the grid's frame, mm."""
    place = world_from_specimen.apply(np.asarray(task.position_mm))
    px, py, pz = grid.world_from_grid.inverse().apply(place).tolist()
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij", sparse=True)
    far = np.sqrt((x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2)
    return far <= max(task.radius_mm, float(far.min())), (px, py, pz)


def _of_gantry(data: dict[str, Any], file: Path) -> Scenario:
    """Return the scenario of plain data with the views of a file and a gantry instead of arms."""
    data = data | {"cell": {"kind": "gantry"}, "motion": {}, "task": None, "until": None}
    data["trajectory"] = {"kind": "file", "path": str(file.resolve())}
    return parse_scenario(data)
