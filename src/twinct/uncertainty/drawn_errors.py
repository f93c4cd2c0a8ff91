"""Random draws of a scenario's errors, for all views of many scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.draws import scan_rng
from twinct.geometry import Floats, exp_matrices
from twinct.uncertainty.correlation import weights
from twinct.uncertainty.drawn_tool import DrawnTool
from twinct.uncertainty.error_terms import SIDES
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.patient import directions, patient_twists
from twinct.uncertainty.sections import PoseNoise, Uncertainty
from twinct.uncertainty.terms.registry import terms_of

Singles = NDArray[np.float32]
"""Type of millions of draws, whose rounding is negligible against their spread."""

CHUNK = 50_000
"""Number of poses of each arm that are drawn at a time."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Random draws of the errors.

    Attributes:
        errors: (draws, views, 12), mm and rad, as defined above.
        true: executed poses relative to the specimen, (2, draws, views, 4, 4), mm.
        believed: believed poses, (2, draws, views, 4, 4), mm.
    """

    errors: Floats
    true: Floats
    believed: Floats


ToolModel = Callable[[int, Floats], Floats]
"""Pose of a tool that the controllers believe, ``world_from_tool``, from side and encoders."""


def draw(
    section: Uncertainty,
    scan: NominalScan,
    draws: int,
    seed: int,
    arms_seed: int,
    tool_model: ToolModel | None = None,
) -> Iterator[tuple[slice, Draws]]:
    """Draw a scenario's errors in chunks of views.

    In the first draw, errors that are constant over a scan match a scan with these seeds.

    Args:
        section: sizes of the errors.
        scan: views.
        draws: number of scans.
        seed: seed of errors that change from view to view.
        arms_seed: seed of errors that are constant over a scan.
        tool_model: calibrated model of the pair of arms with this seed, which then makes all scans.
            None: each scan has other arms, which the controllers believe to be nominal.

    Yields:
        a slice of views, and their draws.
    """
    views = len(scan.time_s)
    tools = [
        DrawnTool(terms_of(section, side), side, chain, arms_seed, 1 if tool_model else draws)
        for side, chain in zip(SIDES, scan.chains or (None, None), strict=True)
    ]
    towards, of_views = directions(arms_seed, draws), _AllViews(seed, draws, views)
    reported = [
        _reported_draws(noise, seed, side, draws, views)
        for noise, side in zip((section.source, section.detector), SIDES, strict=True)
    ]
    encoders, size = scan_rng(seed, "encoders of all"), max(1, CHUNK // draws)
    for first in range(0, views, size):
        part = slice(first, min(first + size, views))
        place = _patient(section, towards, scan.time_s[part])
        true, believed = [], []
        for side in range(2):
            motion = scan.motion(side, part)
            here = known = motion.poses[None]
            if scan.chains:
                known = _encoded(section, scan, side, part, encoders, draws, tool_model)
            moved, twists = tools[side].executed(motion, partial(of_views, part))
            here = here if moved is None else moved
            for twist in twists:
                here = here @ exp_matrices(twist)
            noise = reported[side][:, part].astype(float)
            known = known @ exp_matrices(np.concatenate([0 * noise[..., 3:], noise[..., 3:]], -1))
            known[..., :3, 3] += noise[..., :3]
            here = here if place is None else place @ here
            true.append(np.broadcast_to(here, (draws, *here.shape[1:])))
            believed.append(known)
        yield part, _gathered(np.stack(true), np.stack(believed))


class _AllViews:
    """Standard normal draws of all views of many scans, kept for the chunks to come."""

    def __init__(self, seed: int, draws: int, views: int) -> None:
        self._seed, self._draws, self._views = seed, draws, views
        self._all: dict[str, NDArray[Any]] = {}

    def __call__(self, part: slice, purpose: str, size: int, length: float) -> Floats:
        if purpose not in self._all:
            key, draws, views = f"{purpose} of all", self._draws, self._views
            if size == 1 and not length:
                own = scan_rng(self._seed, key).normal(size=(draws, views))[..., None]
            else:
                own = _alike(self._seed, key, draws, views, length, size)
            self._all[purpose] = own
        return self._all[purpose][:, part]


def _gathered(true: Floats, believed: Floats) -> Draws:
    apart = true[..., :3, 3] - believed[..., :3, 3]
    turns = true[..., :3, :3] @ np.swapaxes(believed[..., :3, :3], -1, -2)
    rotations = scipy.spatial.transform.Rotation.from_matrix(turns.reshape(-1, 3, 3))
    angles = rotations.as_rotvec().reshape(apart.shape)
    both = np.concatenate([apart, angles], axis=-1)
    return Draws(np.concatenate([both[0], both[1]], axis=-1), true, believed)


def _encoded(
    section: Uncertainty,
    scan: NominalScan,
    side: int,
    part: slice,
    rng: np.random.Generator,
    draws: int,
    tool_model: ToolModel | None,
) -> Floats:
    """Return the poses that a model computes from encoders with random errors within a step."""
    joints = scan.joints[side][part][None]
    if step := np.radians(section.encoder_step_deg):
        step = step * scan.chains[side].hinges  # rails are read exactly
        joints = joints + step * rng.uniform(-0.5, 0.5, (draws, *joints.shape[1:]))
    elif tool_model is None:
        return scan.poses[side][None, part]
    return scan.chains[side].tools(joints) if tool_model is None else tool_model(side, joints)


def _patient(section: Uncertainty, towards: Floats, time_s: Floats) -> Floats | None:
    """Return ``place_from_moved``, (draws, views, 4, 4), or None if the specimen rests."""
    if not any(section.patient.sizes):
        return None
    pivot = np.eye(4)
    pivot[:3, 3] = section.patient.pivot_mm
    moved = exp_matrices(patient_twists(section.patient, towards, time_s))
    return pivot @ np.linalg.inv(moved) @ np.linalg.inv(pivot)


def _alike(
    seed: int, purpose: str, draws: int, views: int, length: float, size: int = 6
) -> Singles:
    """Draw standard normal values with a correlation length, (draws, views, size), float32."""
    rng, own = scan_rng(seed, purpose), weights(length)
    white = rng.standard_normal((draws, views + len(own) - 1, size), dtype=np.float32)
    if not length:
        return white
    # Imported here because the import takes half a second.
    from scipy.signal import oaconvolve

    return oaconvolve(white, own[None, :, None].astype(np.float32), mode="valid", axes=1)


def _reported_draws(noise: PoseNoise, seed: int, side: str, draws: int, views: int) -> Singles:
    sigma = np.array([noise.sigma_mm] * 3 + [np.radians(noise.rotation_sigma_deg)] * 3, np.float32)
    result = sigma * _alike(seed, f"reported {side}", draws, views, noise.correlation_views)
    rng = scan_rng(seed, f"reported {side} again")
    cutoff = np.inf if noise.cutoff_mm is None else noise.cutoff_mm
    while (beyond := np.abs(result[..., :3]) > cutoff).any():
        result[..., :3][beyond] = rng.normal(0.0, noise.sigma_mm, int(beyond.sum()))
    return result
