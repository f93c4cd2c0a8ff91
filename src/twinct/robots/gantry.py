"""Gantry in place of arms: source and panel reach their commanded poses exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from twinct.core.errors import MotionError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import JointSample, PosePairs, Reached
from twinct.robots.sections import GantryCell
from twinct.uncertainty import TrueCell
from twinct.xray.sections import Source

STATE = 15
"""Length of a state: simulated time, and the two poses of the last target."""


class Gantry:
    """Replacement of the robot simulation without arms: executed poses equal commanded poses.

    The exceptions are random errors drawn for each view and a moving specimen, if the scenario
    has them.

    A gantry has no joints and checks no collisions: the clearance is NaN. An exposure of finite
    duration is centred on the time of the view. During it, both end-effectors continue the screw
    motion from the previous view to this view, at constant speed.

    Attributes:
        on_joints: callback for joints, which is never called.
    """

    on_joints: Callable[[JointSample], None] | None = None

    def __init__(
        self,
        cell: GantryCell,
        source: Source,
        specimen: Pose,
        *,
        remember: bool = False,
        true_cell: TrueCell | None = None,
    ) -> None:
        """Start at time zero, before the first view.

        Args:
            cell: time from view to view.
            source: exposure time and number of instants of an exposure.
            specimen: ``world_from_specimen``.
            remember: whether each view also reports the poses of the previous view.
            true_cell: true geometry of the cell; None if it is the commanded geometry.
        """
        self._true_cell = true_cell
        self._view_s = cell.view_s
        self._object = (specimen.as_sent(),)
        self._shares: list[float] = []
        if (samples := source.motion_samples) > 1:
            parts = (np.arange(samples) + 0.5) / samples - 0.5
            self._shares = (parts * source.exposure_ms / 1000 / cell.view_s).tolist()
        self._remember = remember
        self._time_s = 0.0
        self._last: PosePairs | None = None

    def follow(self, plan: object) -> None:
        """Do nothing: a gantry follows no plan, but goes straight to each target."""

    def move(self, view: int | None, target: PosePairs) -> Reached:
        """Move to a target, and return the poses there."""
        last, self._last = self._last, target
        last_s, self._time_s = self._time_s, self._time_s + self._view_s
        before = view - 1 if view else None
        none = np.zeros(0)
        return Reached(
            executed=self._really(self._at(target), view, self._time_s),
            joint_names=(),
            position=none,
            velocity=none,
            effort=none,
            state=np.array([self._time_s, *(n for pose in target[0] for n in pose.seven)]),
            time_s=self._time_s,
            clearance_mm=np.nan,
            exposure=PosePairs.joined(
                self._really(self._on(last or target, target, share), view, now_s)
                for share, now_s in zip(
                    self._shares, self._time_s + self._view_s * np.array(self._shares), strict=True
                )
            ),
            before=self._really(self._at(last), before, last_s)
            if last and self._remember
            else None,
        )

    def idle(self, seconds: float) -> float:
        """Let simulated time pass, and return it."""
        self._time_s += seconds
        return self._time_s

    def home(self) -> Reached:
        """Raise an error: a gantry has no home.

        Raises:
            MotionError: always.
        """
        raise MotionError("a gantry has no home: it stays where it was last moved")

    def restore(self, state: Floats) -> None:
        """Restore the exact state of a ``Reached.state``.

        Raises:
            MotionError: the state does not belong to a gantry.
        """
        if np.shape(state) != (STATE,):
            raise MotionError(
                f"the state has shape {np.shape(state)}, but the states of a gantry have ({STATE},)"
            )
        self._time_s, *poses = state.tolist()
        self._last = PosePairs.from_sevens([(poses[:7], poses[7:])])

    def close(self) -> None:
        """Do nothing: a gantry holds no resources."""

    def _really(self, nominal: PosePairs, view: int | None, time_s: float) -> PosePairs:
        return nominal if self._true_cell is None else self._true_cell.at(nominal, view, time_s)

    def _at(self, target: PosePairs) -> PosePairs:
        return replace(target, object=self._object)

    def _on(self, last: PosePairs, target: PosePairs, share: float) -> PosePairs:
        """Return the poses at a fraction of the motion between views, measured from the target."""
        source, detector = map(partial(_screwed, share), last[0], target[0])
        return PosePairs.at(source, detector, *self._object)


def _screwed(share: float, start: Pose, end: Pose) -> Pose:
    """Extrapolate a motion of constant twist beyond its end by a fraction of the motion."""
    return end @ Pose.exp(share * (start.inverse() @ end).log())
