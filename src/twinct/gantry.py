"""A gantry in place of arms: source and panel are exactly where they are told to be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.errors import MotionError
from twinct.geometry import Floats, Pose
from twinct.scenario import GantryCell, Source
from twinct.uncertainty import TrueCell
from twinct.views import Instant, JointSample, Reached, SevenNumbers, Target, from_seven, to_seven

STATE = 15
"""Numbers of a state: simulated time, and the two poses of the last target."""


class Gantry:
    """What a scan needs of a robot simulation, without arms: executed is what was commanded.

    But for what is drawn for each view, and a specimen that moves, where the scenario says so.

    There are no joints, and nothing is looked at that could collide: the clearance is NaN. Where
    an image takes its time, it is centred on the moment of the view, and both end-effectors go on
    in the screw motion that led from the view before to this one, at constant speed.

    Attributes:
        on_joints: would hear of joints; there are none.
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
        """Stand before the first view.

        Args:
            cell: the time from view to view.
            source: how long an image takes, and of how many instants it is made.
            specimen: ``world_from_specimen``.
            remember: whether each view says where the last one was taken.
            true_cell: where everything really is; None: where it is told to be.
        """
        self._true_cell = true_cell
        self._view_s = cell.view_s
        self._object_m = to_seven(specimen)
        self._shares: list[float] = []
        if (samples := source.motion_samples) > 1:
            parts = (np.arange(samples) + 0.5) / samples - 0.5
            self._shares = (parts * source.exposure_ms / 1000 / cell.view_s).tolist()
        self._remember = remember
        self._time_s = 0.0
        self._last: Target | None = None

    def follow(self, plan: object) -> None:
        """There is nothing to follow: a gantry goes straight to each target."""

    def move(self, view: int | None, target: Target) -> Reached:
        """Be at a target, whichever view it is."""
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
            state=np.array([self._time_s, *target.source_m, *target.detector_m]),
            time_s=self._time_s,
            clearance_mm=np.nan,
            exposure=tuple(
                self._really(self._on(last or target, target, share), view, now_s)
                for share, now_s in zip(
                    self._shares, self._time_s + self._view_s * np.array(self._shares), strict=True
                )
            ),
            before=self._really(self._at(last), before, last_s)
            if last and self._remember
            else None,
        )

    def home(self) -> Reached:
        """Refused.

        Raises:
            MotionError: always.
        """
        raise MotionError("a gantry has no home: it is where it was last told to be")

    def restore(self, state: Floats) -> None:
        """Go back exactly to ``Reached.state``.

        Raises:
            MotionError: the state is no gantry's.
        """
        if np.shape(state) != (STATE,):
            raise MotionError(
                f"a state of shape {np.shape(state)} is not of a gantry, whose states have "
                f"({STATE},)"
            )
        self._time_s, *poses = state.tolist()
        self._last = Target(tuple(poses[:7]), tuple(poses[7:]))

    def close(self) -> None:
        """Nothing is held."""

    def _really(self, told: Instant, view: int | None, time_s: float) -> Instant:
        return told if self._true_cell is None else self._true_cell.at(told, view, time_s)

    def _at(self, target: Target) -> Instant:
        return Instant(target.source_m, self._object_m, target.detector_m)

    def _on(self, last: Target, target: Target, share: float) -> Instant:
        """Where everything is after a share of the way from view to view, from the target on."""
        return Instant(
            _screwed(last.source_m, target.source_m, share),
            self._object_m,
            _screwed(last.detector_m, target.detector_m, share),
        )


def _screwed(start: SevenNumbers, end: SevenNumbers, share: float) -> SevenNumbers:
    """Behind the end of a way of constant twist, by a share of it."""
    pose = from_seven(end)
    return to_seven(pose @ Pose.exp(share * (from_seven(start).inverse() @ pose).log()))
