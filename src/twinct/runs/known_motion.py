"""A patient's motion after the scan: states of the views, gating, compensation, moving voxels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, Pose, ScanGeometry, VolumeGrid
from twinct.recon.moving import MovingProjector, moving_bytes
from twinct.recon.projector import Projector
from twinct.scan import Scan
from twinct.scenario import KnownMotion, Scenario
from twinct.scenario.imported import ScanSettings
from twinct.specimen import BuiltSpecimen
from twinct.specimen.body_motion import body_motion
from twinct.specimen.breathing import Breath, gated
from twinct.specimen.deformation import Between

if TYPE_CHECKING:
    from twinct.specimen.body_motion import BodyMotion
    from twinct.specimen.breathing import Breath
    from twinct.specimen.deformation import Between, Deformation

MOVING_MM = 2.0
"""Way in a usual breath from which a voxel counts as moving."""


def _motion_of(settings: ScanSettings) -> BodyMotion | None:
    """Return the motion of a known specimen, whose modules load only where one moves."""
    if settings.specimen is None or settings.specimen.motion is None:
        return None
    return body_motion(settings.specimen)


def state_of_volume(scenario: Scenario) -> Breath:
    """Return the state of breathing that a scenario reconstructs, and its truth shows."""
    known = scenario.reconstruction.motion
    return Breath(known.phase if known else 0.0)


def as_reconstructed(specimen: BuiltSpecimen, scenario: Scenario) -> BuiltSpecimen:
    """Return a specimen in the state of breathing that a scenario reconstructs."""
    if specimen.motion is None:
        return specimen
    state = state_of_volume(scenario)
    return specimen if specimen.motion.displacement.rests(state) else specimen.at(state)


def phase_of_truth(scenario: Scenario) -> str:
    """Return the state that is reconstructed as text; empty without a motion."""
    return str(state_of_volume(scenario).phase) if scenario.specimen.motion else ""


def views_that_count(settings: ScanSettings, times_s: Floats) -> list[int] | None:
    """Return the views whose phase lies in ``reconstruction.motion.gate``; None for all.

    Args:
        settings: settings of the scan.
        times_s: time of each view.

    Raises:
        InputError: there is none.
    """
    known, motion = settings.reconstruction.motion, _motion_of(settings)
    if known is None or known.gate is None or motion is None:
        return None
    chosen = gated([motion.at(float(t)) for t in times_s], known.gate)
    if not chosen:
        low, high = known.gate
        raise InputError(
            f"reconstruction.motion.gate: none of the {len(times_s)} views has a phase between "
            f"{low:g} and {high:g}"
        )
    return chosen


def gated_scan(
    scan: Scan, poses: ScanGeometry, pixels: NDArray[np.bool_] | None, views: list[int]
) -> tuple[Scan, ScanGeometry, NDArray[np.bool_] | None]:
    """Return some views of a scan, of their poses, and of their good pixels."""
    of_views = pixels[views] if pixels is not None and pixels.ndim == 3 else pixels
    return scan.of_views(views), poses[views], of_views


def projector_of(scan: Scan, poses: ScanGeometry, grid: VolumeGrid) -> Projector:
    """Return the projector of a scan's views, which compensates the motion that is known."""
    known, motion = scan.settings.reconstruction.motion, _motion_of(scan.settings)
    if known is None or not known.compensate or motion is None:
        return Projector(poses, grid)
    states = deformations(motion, known, scan.middle_s, scan.stands)
    return MovingProjector(poses, grid, states)


def motion_bytes(settings: ScanSettings, views: int) -> int:
    """Return the bytes that a compensated motion needs beside an algorithm; 0 without one."""
    known, grid = settings.reconstruction.motion, settings.reconstruction.volume_grid
    if known is None or not known.compensate:
        return 0
    return moving_bytes(grid, views)


def deformations(
    motion: BodyMotion, known: KnownMotion, times_s: Floats, world_from_specimen: Pose
) -> list[Deformation | Between]:
    """Return the believed deformation of the body in each view, from the volume's state."""
    believed = motion.scaled(known.amplitude_rel)
    state = Breath(known.phase)
    held = believed.deformation(state, world_from_specimen)
    rests = believed.displacement.rests(state)
    results: dict[Breath, Deformation | Between] = {}
    states = [believed.at(float(t) - known.delay_s) for t in times_s]
    for state in states:
        if state not in results:
            now = believed.deformation(state, world_from_specimen)
            results[state] = now if rests else Between(now, held)
    return [results[state] for state in states]


def moving_voxels(
    motion: BodyMotion, grid: VolumeGrid, world_from_specimen: Pose
) -> NDArray[np.bool_]:
    """Return the voxels that move by ``MOVING_MM`` or more in a usual breath, (z, y, x)."""
    step = max(1, int(MOVING_MM * 2 / grid.voxel.max()))
    counts = [max(2, -(-(n - 1) // step) + 1) for n in grid.shape]
    nodes = step * np.indices(counts).reshape(3, -1)[::-1].T
    points = nodes @ grid.affine[:3, :3].T + grid.affine[:3, 3]
    ways = motion.displacements_mm(world_from_specimen.inverse().apply(points)).reshape(counts)
    moving = np.empty(grid.shape, np.bool_)
    rows = np.indices(grid.shape[1:]) / step
    for k in range(grid.shape[0]):
        at = np.stack([np.full(grid.shape[1:], k / step), *rows])
        moving[k] = scipy.ndimage.map_coordinates(ways, at, order=1) >= MOVING_MM
    return moving


def moving_figures(
    scan: Scan,
    volume: NDArray[np.float32],
    truth: NDArray[np.float32],
    region: NDArray[np.bool_],
    mu_reference: float,
    grid: VolumeGrid,
) -> dict[str, float]:
    """Return the error in the moving part of a region; nothing if no part moves.

    Args:
        scan: the scan, with its scenario.
        volume: attenuation, (z, y, x), 1/mm.
        truth: true attenuation, (z, y, x), 1/mm.
        region: voxels that every view sees, (z, y, x).
        mu_reference: attenuation to which figures are relative, 1/mm.
        grid: grid of the volume.
    """
    motion = _motion_of(scan.scenario)
    if motion is None:
        return {}
    moving = moving_voxels(motion, grid, scan.stands) & region
    off = volume[moving].astype(np.float64) - truth[moving]
    rmse = float(np.sqrt(np.mean(off**2))) / mu_reference if off.size else float("nan")
    return {"rmse_moving_rel": rmse, "moving_fraction": float(moving.sum() / region.sum())}


def motion_in_words(scenario: Scenario, times_s: Floats) -> str:
    """Return a patient's motion during a scan in one line."""
    section, motion = scenario.specimen.motion, _motion_of(scenario)
    assert section is not None and motion is not None
    first, last = (motion.at(float(t)) for t in (times_s[0], times_s[-1]))
    breaths = (times_s[-1] - times_s[0]) / section.period_s
    words = f"{quoted(motion.part)} breathes about {breaths:.1f} times of {section.period_s:g} s"
    words += f", from phase {first.phase:.2f} to {last.phase:.2f}"
    if section.irregularity:
        words += f", irregular by {100 * section.irregularity:g} %"
    if section.drift_per_min:
        words += f", drift {section.drift_per_min:g} depths a minute"
    return words
