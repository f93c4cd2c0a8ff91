"""Executed poses of source, specimen and panel, computed from the poses the controllers believe."""

from __future__ import annotations

import numpy as np

from twinct.core.draws import view_rng
from twinct.geometry import Chain, Floats, Pose
from twinct.geometry.wire import Instant, from_seven, to_seven
from twinct.scenario import Uncertainty, ViewErrors
from twinct.uncertainty.arms import S_PER_MS, Moment, drawn, true_tools
from twinct.uncertainty.correlation import view_normals
from twinct.uncertainty.patient import world_from_moved

SIDES = ("source", "detector")


def view_sigmas(section: ViewErrors) -> tuple[Floats, Floats]:
    """Return standard deviations of the twists (v, w) of source and panel in their axes, (6,)."""
    tilt, turn = np.radians([section.detector_tilt_deg, section.detector_turn_deg])
    plane, normal = section.detector_in_plane_mm, section.detector_normal_mm
    source = np.array([section.source_mm] * 3 + [0.0] * 3)
    return source, np.array([plane, plane, normal, tilt, tilt, turn])


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
        self._section, self._seed, self._arms_seed = uncertainty, seed, arms_seed
        self._arms = None
        if chains is not None and any(uncertainty.arms.sizes):
            self._arms = [
                (chain, drawn(uncertainty.arms, chain, arms_seed, side))
                for chain, side in zip(chains, SIDES, strict=True)
            ]

    def at(
        self,
        nominal: Instant,
        view: int | None,
        time_s: float,
        joints: Floats | None = None,
        speeds: Floats | None = None,
    ) -> Instant:
        """Return the executed poses at an instant.

        Args:
            nominal: poses that the controllers believe.
            view: exposed view; None outside a scan, without the random errors of a view.
            time_s: simulated time.
            joints: joint positions of both arms, source first, rad; None with a gantry.
            speeds: joint speeds, rad/s.
        """
        source, detector = nominal.source_m, nominal.detector_m
        if self._arms is not None and joints is not None and speeds is not None:
            poses = self._true_poses(joints, speeds, view, time_s)
            source, detector = map(to_seven, poses)
        views = self._section.views
        if view is not None and any(views.sizes):
            source, detector = (
                to_seven(from_seven(at) @ Pose.exp(sigma * self._normals(side, view)))
                for at, sigma, side in zip(
                    (source, detector), view_sigmas(views), SIDES, strict=True
                )
            )
        stands = nominal.object_m
        if any((patient := self._section.patient).sizes):
            stands = to_seven(world_from_moved(patient, self._arms_seed, time_s) @ nominal.object)
        return Instant(source, stands, detector)

    def _normals(self, side: str, view: int) -> Floats:
        length = self._section.views.correlation_views
        return view_normals(self._seed, f"view {side}", view, 6, length)

    def _true_poses(
        self, joints: Floats, speeds: Floats, view: int | None, time_s: float
    ) -> list[Pose]:
        section, found, first = self._section.arms, [], 0
        late_ms = section.trigger_delay_ms
        if view is not None:
            late_ms += section.trigger_jitter_ms * view_rng(self._seed, "trigger", view).normal()
        for chain, deviation in self._arms or ():
            own = slice(first, first := first + len(chain))
            moment = Moment(joints[None, own], speeds[None, own], np.array([time_s]))
            late_s = np.full((1, 1), late_ms * S_PER_MS)
            matrix = true_tools(section, chain, deviation, moment, late_s)[0, 0]
            found.append(Pose.from_matrix(matrix[:3, 3], matrix[:3, :3]))
        return found
