"""Executed poses of source, specimen and panel, computed from the poses the controllers believe."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinct.geometry import Chain, Floats, Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.uncertainty.correlation import view_normals
from twinct.uncertainty.drawn_tool import DrawnTool
from twinct.uncertainty.error_terms import SIDES, ToolMotion, ViewDraws, own_accelerations
from twinct.uncertainty.patient import world_from_moved
from twinct.uncertainty.sections import Uncertainty
from twinct.uncertainty.terms.registry import terms_of


class TrueCell:
    """True geometry of a scan whose controllers know only the nominal geometry.

    The executed poses are a function of the scenario, the view, and the controllers' values at an
    instant. No state is stored, so that a resumed scan gets equal poses.
    """

    def __init__(
        self,
        uncertainty: Uncertainty,
        seed: int,
        arms_seed: int,
        chains: tuple[Chain, Chain] | None = None,
    ) -> None:
        """Draw the errors that are constant over a scan.

        Args:
            uncertainty: section of the scenario.
            seed: seed of errors that change from view to view.
            arms_seed: seed of errors that are constant over a scan.
            chains: nominal arms; None with a gantry.
        """
        self._seed, self._arms_seed = seed, arms_seed
        self._patient = uncertainty.patient if any(uncertainty.patient.sizes) else None
        self._tools: list[tuple[DrawnTool, Chain | None, slice]] = []
        first = 0
        for side, chain in zip(SIDES, chains or (None, None), strict=True):
            own = slice(first, first := first + len(chain or ()))
            tool = DrawnTool(terms_of(uncertainty, side), side, chain, arms_seed)
            self._tools.append((tool, chain, own))

    def check(self, views: ScanGeometry) -> None:
        """Check the errors of a gantry's views, before anything moves.

        Raises:
            InputError: an error belongs to arms, or deviates a part that it does not declare.
        """
        first = views[:1]
        source, panel = first.source_poses()[0], first.detector_poses()[0]
        self.at(PosePairs.at(source, panel, Pose.identity()), 0, 0.0)

    def at(
        self,
        nominal: PosePairs,
        view: int | None,
        time_s: float,
        joints: Floats | None = None,
        speeds: Floats | None = None,
        accelerations: Callable[[Floats], Floats] | None = None,
    ) -> PosePairs:
        """Return the executed poses at an instant.

        Args:
            nominal: poses that the controllers believe, one instant.
            view: exposed view; None outside a scan, without the random errors of a view.
            time_s: simulated time.
            joints: joint positions of both arms, source first, rad; None with a gantry.
            speeds: joint speeds, rad/s.
            accelerations: planned joint accelerations of both arms at some simulated times,
                (times, joints), rad/s^2; None if nothing moves by a plan.
        """
        of_views, poses = self._draws_of(view), list(nominal[0])
        for k, (tool, chain, own) in enumerate(self._tools):
            at = poses[k]
            here, times = at.matrix[None], np.array([time_s])
            if joints is None or speeds is None:
                chain, joints, speeds = None, np.zeros(0), np.zeros(0)
            motion = ToolMotion(
                *(SIDES[k], here, times, chain, joints[None, own], speeds[None, own]),
                own_accelerations(accelerations, own),
            )
            moved, twists = tool.executed(motion, of_views)
            if moved is not None:
                matrix = moved[0, 0]
                at = Pose.from_matrix(matrix[:3, 3], matrix[:3, :3]).as_sent()
            for twist in twists:
                at = (at @ Pose.exp(twist[0, 0])).as_sent()
            poses[k] = at
        (stands,) = nominal.object
        if self._patient is not None:
            moved = world_from_moved(self._patient, self._arms_seed, time_s)
            stands = (moved @ stands).as_sent()
        return PosePairs((poses[0],), (poses[1],), (stands,))

    def _draws_of(self, view: int | None) -> ViewDraws:
        def draws(purpose: str, size: int, length: float) -> Floats | None:
            if view is None:
                return None
            return view_normals(self._seed, purpose, view, size, length)[None, None]

        return draws
