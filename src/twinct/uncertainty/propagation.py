"""Effects of a scenario's errors on the geometry of its views, computed before anything moves.

An error separates an executed pose from a believed pose: displacement and rotation of a tool,
(v, w) in mm and rad, both in world axes. The errors of source and panel are stacked, (12,). A
moving specimen counts as the opposite motion of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from twinct.geometry import Floats, Panel
from twinct.uncertainty.drawn_errors import Singles, draw
from twinct.uncertainty.first_order import FirstOrder, first_order
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.sections import Uncertainty

STEP = 1e-3
"""Step of the difference quotients of projections, mm and rad."""


def pixel_jacobian(scan: NominalScan, panel: Panel, points: Floats) -> Floats:
    """Return the derivatives of points' images with respect to errors: executed minus believed.

    Args:
        scan: views.
        panel: pixel lattice.
        points: (points, 3), mm.

    Returns:
        (views, points, 2, 12), pixels per mm and rad.
    """
    columns = []
    for column in range(12):
        step = np.zeros(6)
        step[column % 6] = STEP
        ends = []
        for sign in (1, -1):
            poses = scan.poses.copy()
            poses[column // 6] = _displaced(poses[column // 6], sign * step)
            ends.append(project(poses[:, None], panel, points)[0])
        columns.append((ends[0] - ends[1]) / (2 * STEP))
    return np.stack(columns, axis=-1)


def _displaced(poses: Floats, error: Floats) -> Floats:
    displaced = poses.copy()
    displaced[..., :3, 3] += error[:3]
    turn = scipy.spatial.transform.Rotation.from_rotvec(error[3:])
    displaced[..., :3, :3] = turn.as_matrix() @ poses[..., :3, :3]
    return displaced


def project(poses: Floats, panel: Panel, points: Floats) -> Floats:
    """Project points with many geometries.

    Args:
        poses: source and panel, (2, draws, views, 4, 4), mm.
        panel: pixel lattice.
        points: (points, 3), mm.

    Returns:
        fractional (column, row), (draws, views, points, 2).
    """
    source, detector = poses[0][..., None, :3, 3], poses[1][..., :3, 3][..., None, :]
    u, v, normal = np.moveaxis(poses[1][..., :3, :3], -1, 0)[..., None, :]
    rays = points - source
    to_panel = detector - source
    reach = (to_panel * normal).sum(-1) / (rays * normal).sum(-1)
    offset = reach[..., None] * rays - to_panel
    column, row = (offset * u).sum(-1) / panel.pitch_u, (offset * v).sum(-1) / panel.pitch_v
    return np.stack([column, row], axis=-1) + panel.middle


@dataclass(frozen=True, eq=False)
class Propagation:
    """Effects of a scenario's errors on the geometry of its views.

    Attributes:
        analytic: first-order covariances.
        errors: drawn errors, (draws, views, 12), mm and rad.
        points: points for errors in the image, the isocentre first, (points, 3), mm.
        pixels: distance between the executed and the believed image of a point,
            (draws, views, points), pixels.
        jacobian: derivatives of the images, (views, points, 2, 12), pixels per mm and rad.
    """

    analytic: FirstOrder
    errors: Floats
    points: Floats
    pixels: Singles
    jacobian: Floats

    def shares(self) -> list[dict[str, float | str]]:
        """Return the first-order effect of each cause alone over all views, largest first.

        Values are root mean squares: displacement and rotation of source and panel, and distances
        in the image of the isocentre and of the other points.
        """
        rows: list[dict[str, float | str]] = []
        for term in (*self.analytic.terms, *self.analytic.means):
            rms = np.sqrt((term.factor**2).sum(axis=2).mean(axis=0))
            image = self.jacobian @ term.factor[:, None]
            rows.append(
                {
                    "term": term.name,
                    "source_mm": float(np.linalg.norm(rms[:3])),
                    "source_deg": float(np.degrees(np.linalg.norm(rms[3:6]))),
                    "detector_mm": float(np.linalg.norm(rms[6:9])),
                    "detector_deg": float(np.degrees(np.linalg.norm(rms[9:]))),
                    "isocentre_px": _rms_px(image[:, :1]),
                    "region_px": _rms_px(image[:, 1:]),
                }
            )
        return sorted(rows, key=lambda row: -float(row["region_px"]))


def _rms_px(image: Floats) -> float:
    """Return the RMS distance in the image from shifts per draw, (views, points, 2, draws)."""
    return float(np.sqrt((image**2).sum(axis=(2, 3)).mean())) if image.size else float("nan")


def propagate(
    section: Uncertainty,
    scan: NominalScan,
    panel: Panel,
    points: Sequence[Sequence[float]] | Floats,
    *,
    draws: int,
    seed: int,
    arms_seed: int,
) -> Propagation:
    """Draw a scenario's errors, and compute their first-order covariances.

    Args:
        section: errors of the scenario.
        scan: views of the scenario.
        panel: pixel lattice.
        points: points for errors in the image, the isocentre first, (points, 3), mm.
        draws: number of scans.
        seed: seed of errors that change from view to view.
        arms_seed: seed of errors that are constant over a scan.
    """
    where = np.asarray(points, dtype=np.float64)
    errors = np.zeros((draws, len(scan.time_s), 12))
    pixels = np.zeros((draws, len(scan.time_s), len(where)), np.float32)
    for part, drawn_now in draw(section, scan, draws, seed, arms_seed):
        errors[:, part] = drawn_now.errors
        ends = (project(poses, panel, where) for poses in (drawn_now.true, drawn_now.believed))
        pixels[:, part] = np.linalg.norm(np.subtract(*ends), axis=-1)
    analytic = first_order(section, scan)
    return Propagation(analytic, errors, where, pixels, pixel_jacobian(scan, panel, where))
