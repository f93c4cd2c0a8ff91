"""First-order effect of each cause of error on all views of a scan.

To first order, each term causes a zero-mean error that is linear in standard normal draws. Its
factor F_v in view v gives the covariance r(v, w) F_v F_w' of two views. Here r is 1 for errors that
are constant over a scan, exp(-d^2 / 2 length^2) at a distance of d views for correlated errors, and
0 for errors that are drawn anew. A gear error of random phase is a cosine and a sine of independent
amplitudes, whose covariance is exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinct.geometry import Floats, exp_matrices
from twinct.scenario import PoseNoise, Uncertainty
from twinct.uncertainty.arms import S_PER_MS, coldness, mean_compliance, spreads
from twinct.uncertainty.executed import view_sigmas
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.patient import amplitudes

CONSTANT = np.inf
"""Correlation length of errors that are constant over a scan."""


@dataclass(frozen=True, eq=False)
class Term:
    """First-order effect of one cause on all views.

    Attributes:
        name: name of the cause.
        factor: errors per standard draw, (views, 12, draws), mm and rad.
        length: correlation length in views: ``CONSTANT``, a number, or 0.
    """

    name: str
    factor: Floats
    length: float

    def alike(self, apart: Floats) -> Floats:
        """Return the correlation of the draws of two views at a distance of ``apart`` views."""
        if self.length == CONSTANT:
            return np.ones_like(apart, dtype=float)
        if not self.length:
            return (apart == 0).astype(float)
        return np.exp(-((apart / self.length) ** 2) / 2)


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """First-order covariances of all views, and their means.

    Attributes:
        terms: all random causes.
        means: systematic errors that are equal in all draws, each with a draw of 1.
        views: number of views.
    """

    terms: tuple[Term, ...]
    means: tuple[Term, ...]
    views: int

    def covariance(self, one: int, other: int) -> Floats:
        """Return the covariance of the errors of view ``one`` (rows) and ``other``, (12, 12)."""
        found = np.zeros((12, 12))
        for term in self.terms:
            apart = np.array(float(one - other))
            found += term.alike(apart) * term.factor[one] @ term.factor[other].T
        return found

    @cached_property
    def covariances(self) -> Floats:
        """Covariance of the errors within each view, (views, 12, 12)."""
        return sum(
            (term.factor @ np.swapaxes(term.factor, 1, 2) for term in self.terms),
            np.zeros((self.views, 12, 12)),
        )


def first_order(section: Uncertainty, scan: NominalScan) -> FirstOrder:
    """Compute the first-order covariances of a scenario's errors, without draws."""
    found = [
        *(_of_arms(section, scan) if scan.chains else ()),
        *_of_views(section, scan),
        *_reported(section),
    ]
    views = len(scan.time_s)
    means = _means(section, scan) if scan.chains else ()
    terms: dict[tuple[str, float], list[Floats]] = {}
    for term in found:
        if term.factor.any():
            factor = np.broadcast_to(term.factor, (views, *term.factor.shape[1:]))
            terms.setdefault((term.name, term.length), []).append(factor)
    joined = tuple(
        Term(name, np.concatenate(parts, axis=2), length) for (name, length), parts in terms.items()
    )
    return FirstOrder(joined, tuple(term for term in means if term.factor.any()), views)


def _carried(frames: Floats, tools: Floats) -> Floats:
    """Return matrices from twists of frames, in their axes, to errors of tools, (..., 6, 6)."""
    rotation = frames[..., :3, :3]
    arms = tools[..., :3, 3] - frames[..., :3, 3]
    found = np.zeros((*rotation.shape[:-2], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = rotation
    # The columns are w x r for each axis of the frame.
    turned = np.cross(np.swapaxes(rotation, -1, -2), arms[..., None, :])
    found[..., :3, 3:] = np.swapaxes(turned, -1, -2)
    return found


def _of_side(side: int, factor: Floats) -> Floats:
    """Extend a factor of one end-effector, (views, 6, draws), to both, (views, 12, draws)."""
    both = np.zeros((len(factor), 12, factor.shape[2]))
    both[:, 6 * side : 6 * side + 6] = factor
    return both


def _of_arms(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    arms, views = section.arms, len(scan.time_s)
    missed = np.zeros((views, 12, 1))
    for side, (chain, moment) in enumerate(zip(scan.chains, scan.moments, strict=True)):
        tools = scan.poses[side]
        frames = chain.frames(moment.joints)[:, :-1]
        # A link's errors refer to the axes of its frame before the rotation of the joint.
        still = frames @ np.linalg.inv(exp_matrices(_about_z(moment.joints)))
        places = {
            "base": _carried(np.broadcast_to(chain.base, tools.shape), tools)[:, None],
            "links": _carried(still, tools[:, None]),
            "tool": _carried(tools, tools)[:, None],
        }
        for term, frame, sigma in spreads(arms):
            factor = places[frame] * sigma
            yield Term(term, _of_side(side, _columns(factor)), CONSTANT)
        growth = arms.drift_mm * coldness(arms, moment.time_s)[:, None, None, None]
        yield Term("drift", _of_side(side, _columns(growth * places["links"][..., :3])), CONSTANT)
        turns = places["links"][..., 5]  # of each joint about its axis, (views, joints, 6)

        def by_joint(angles: Floats, turns: Floats = turns) -> Floats:
            return np.swapaxes(turns * angles[..., None], 1, 2)

        torques = chain.gravity_torques(moment.joints)
        windup = arms.windup_spread * mean_compliance(arms, chain) * torques
        yield Term("windup", _of_side(side, by_joint(windup)), CONSTANT)
        periods = arms.gear_periods * moment.joints
        for wave in (np.cos(periods), np.sin(periods)):
            gear = np.radians(arms.gear_deg) / np.sqrt(2) * wave
            yield Term("gear", _of_side(side, by_joint(gear)), CONSTANT)
        # Quantisation leaves an error that is uniform over one encoder step.
        step = np.radians(section.encoder_step_deg) / np.sqrt(12)
        step = np.broadcast_to(step, moment.joints.shape)
        yield Term("encoder", _of_side(side, by_joint(step)), 0.0)
        jitter = arms.trigger_jitter_ms * S_PER_MS * moment.speeds
        missed[:, 6 * side : 6 * side + 6, 0] = by_joint(jitter).sum(axis=2)
    yield Term("trigger", missed, 0.0)


def _means(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    """Yield the effects of the mean wind-up of all gears and the mean delay of the triggers."""
    wound, late = np.zeros((2, len(scan.time_s), 12, 1))
    for side, (chain, moment) in enumerate(zip(scan.chains, scan.moments, strict=True)):
        frames = chain.frames(moment.joints)[:, :-1]
        turns = _carried(frames, scan.poses[side][:, None])[..., 5]
        angles = mean_compliance(section.arms, chain) * chain.gravity_torques(moment.joints)
        way = section.arms.trigger_delay_ms * S_PER_MS * moment.speeds
        rows = slice(6 * side, 6 * side + 6)
        wound[:, rows, 0] = np.einsum("vji,vj->vi", turns, angles)
        late[:, rows, 0] = np.einsum("vji,vj->vi", turns, way)
    yield Term("windup, mean", wound, CONSTANT)
    yield Term("trigger, mean", late, CONSTANT)


def _about_z(angles: Floats) -> Floats:
    twists = np.zeros((*angles.shape, 6))
    twists[..., 5] = angles
    return twists


def _columns(factor: Floats) -> Floats:
    """Reshape (views, frames, 6, draws) to (views, 6, frames x draws), without zero columns."""
    flat = np.moveaxis(factor, 1, 2).reshape(len(factor), 6, -1)
    return flat[:, :, flat.any(axis=(0, 1))]


def _of_views(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    for side, sigma in enumerate(view_sigmas(section.views)):
        tools = scan.poses[side]
        factor = _carried(tools, tools) * sigma
        yield Term("views", _of_side(side, factor), section.views.correlation_views)
    patient = section.patient
    sizes = amplitudes(patient, scan.time_s)  # a random direction has a mean square of 1/3 per axis
    pivot = np.eye(4)
    pivot[:3, 3] = patient.pivot_mm
    both = np.concatenate(
        [_carried(np.broadcast_to(pivot, t.shape), t) for t in scan.poses], axis=1
    )
    for part in range(4):
        axes = slice(0, 3) if part % 2 == 0 else slice(3, 6)
        factor = -both[:, :, axes] * sizes[:, part, None, None] / np.sqrt(3)
        yield Term("patient", factor, CONSTANT)


def _reported(section: Uncertainty) -> Iterator[Term]:
    for side, noise in enumerate((section.source, section.detector)):
        sigma = np.array([_cut_sigma(noise)] * 3 + [np.radians(noise.rotation_sigma_deg)] * 3)
        yield Term("reported", _of_side(side, np.diag(sigma)[None]), noise.correlation_views)


def _cut_sigma(noise: PoseNoise) -> float:
    """Return the standard deviation of an axis after redraws beyond the cut-off."""
    if noise.cutoff_mm is None or not noise.sigma_mm:
        return noise.sigma_mm
    # Imported here because the import takes half a second.
    from scipy.stats import truncnorm

    cut = noise.cutoff_mm / noise.sigma_mm
    return noise.sigma_mm * float(truncnorm(-cut, cut).std())
