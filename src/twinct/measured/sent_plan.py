"""The plan that ``twinct drive`` sent to real arms, beside what they and the detector did."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import library_errors
from twinct.core.files.private import temporary_folder
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.measured.joint_track import JointTrack

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

NO_VIEWS = "the executed poses also stand for the commanded ones"
UNFIT = f"the images do not fit the views of the plan one by one: {NO_VIEWS}"
SET_BACK = f"a driver's clock was set back, so no time tells which view an image shows: {NO_VIEWS}"


@dataclass(frozen=True, eq=False)
class SentPlan:
    """A plan, and when it was followed.

    Attributes:
        plan: the plan.
        start_s: time at which it was to start.
        slower: duration of the motion over that of the plan.
        lag_s: time by which the arms followed it.
    """

    plan: MotionPlan
    start_s: float
    slower: float
    lag_s: float

    @classmethod
    def of(cls, content: bytes, start_s: float, duration_s: float, track: JointTrack) -> SentPlan:
        """Read the plan of a recording.

        Args:
            content: its file.
            start_s: time at which it was to start.
            duration_s: duration of the motion.
            track: the joints.

        Raises:
            InputError: it is no plan, or no joint moved.
        """
        from twinct.robots.motion import load_plan

        where = "the plan in the recording"
        with temporary_folder() as folder, library_errors(where):
            (file := folder / "plan.npz").write_bytes(content)
            try:
                plan = load_plan(file)
            except InputError as error:
                raise InputError(str(error).replace(str(file), where)) from None
            if not 0 < duration_s < math.inf:
                raise ValueError(f"executed in {duration_s} s")
            slower = duration_s / plan.duration_s
            return cls(plan, start_s, slower, track.lag_s(plan, start_s, slower))

    @property
    def due_s(self) -> Floats:
        """Time at which each view was to be taken by arms without lag, (views,)."""
        return self.start_s + self.slower * self.plan.exposures_s

    def views_at(self, time_s: Floats) -> NDArray[np.intp] | None:
        """Return the view of the plan that was taken at each time.

        Args:
            time_s: rising times of exposures, (images,).

        Returns:
            None unless each time is nearest to another view, and to none of its neighbours by more
            than half of the least time between views.
        """
        due_s = self.due_s + self.lag_s
        off = np.abs(time_s[:, None] - due_s)
        views = off.argmin(axis=1)
        apart_s = np.diff(due_s).min(initial=np.inf)
        unfit = off.min(axis=1).max() > apart_s / 2 or (np.diff(views) <= 0).any()
        return None if unfit else views

    def commanded(self, views: NDArray[np.intp]) -> PosePairs:
        """Return the commanded poses of some views."""
        return PosePairs.joined(self.plan.targets[view] for view in views.tolist())

    def beside(self, views: NDArray[np.intp], time_s: Floats) -> Mapping[str, Any]:
        """Return the times of the plan and of the images, from the start of the motion.

        Args:
            views: views of the plan, (images,).
            time_s: times of the exposures, (images,).
        """
        return {
            "views": views.tolist(),
            "planned_s": (self.due_s[views] - self.start_s).tolist(),
            "taken_s": (time_s - self.start_s).tolist(),
        }
