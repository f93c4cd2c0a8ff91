"""Distance of the end-effectors from their commanded poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.geometry.wire import PosePairs


@dataclass(frozen=True, eq=False)
class ToolErrors:
    """Pose errors of one end-effector.

    Attributes:
        position_mm: distance between the two origins, (views,), mm.
        rotation_deg: angle of the relative rotation, (views,), degrees.
    """

    position_mm: Floats
    rotation_deg: Floats

    def summary(self) -> dict[str, dict[str, float]]:
        """Return mean, standard deviation (ddof 0) and maximum over the views of each error."""
        figures = {"mean": np.mean, "std": np.std, "max": np.max}
        return {
            name: {figure: float(of(values)) for figure, of in figures.items()}
            for name, values in vars(self).items()
        }


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Pose errors of both end-effectors: the focal spot's frame and the panel's frame."""

    source: ToolErrors
    detector: ToolErrors

    def summary(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return ``{source, detector} -> {position_mm, rotation_deg} -> {mean, std, max}``."""
        return {"source": self.source.summary(), "detector": self.detector.summary()}


def pose_errors(commanded: PosePairs, executed: PosePairs) -> PoseErrors:
    """Compare two sets of poses view by view, executed against commanded.

    Raises:
        ValueError: no views, or different numbers of views.
    """
    if not len(commanded) or len(commanded) != len(executed):
        raise ValueError(
            f"{len(commanded)} commanded and {len(executed)} executed views: "
            "both must have the same views, at least one"
        )
    source = _arm_errors(commanded.source, executed.source)
    return PoseErrors(source, _arm_errors(commanded.detector, executed.detector))


def reprojection_px(true: ScanGeometry, taken: ScanGeometry, points: ArrayLike) -> Floats:
    """Return the distances between the images of points in two geometries of the same views.

    Args:
        true: executed geometry.
        taken: assumed geometry.
        points: (points, 3), mm.

    Returns:
        (views, points), pixels; NaN if the point has no image in one geometry.
    """
    return np.linalg.norm(taken.project(points) - true.project(points), axis=-1)


def tool_speeds(executed: PosePairs, simulated_s: Floats) -> dict[str, dict[str, float]]:
    """Return mean and largest speed of both tools from view to view, in straight lines, mm/s.

    Args:
        executed: poses of at least two views.
        simulated_s: time of each view, (views,).
    """
    seconds, by_side = np.diff(simulated_s), {}
    for side in ("source", "detector"):
        places = np.array([pose.position for pose in getattr(executed, side)])
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / seconds
        by_side[side] = {"mean": float(speeds.mean()), "max": float(speeds.max())}
    return by_side


def _arm_errors(wanted: Sequence[Pose], actual: Sequence[Pose]) -> ToolErrors:
    shift = np.array([a.position - w.position for w, a in zip(wanted, actual, strict=True)])
    before, after = (
        scipy.spatial.transform.Rotation.from_quat([p.quat for p in poses])
        for poses in (wanted, actual)
    )
    turn = before.inv() * after
    return ToolErrors(np.linalg.norm(shift, axis=1), np.degrees(turn.magnitude()))
