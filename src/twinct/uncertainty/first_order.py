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

from twinct.geometry import Floats
from twinct.uncertainty.arm_model import carried, derivatives
from twinct.uncertainty.drawn_tool import by_view, keyed_spreads
from twinct.uncertainty.error_terms import CONSTANT, SIDES, Place, Spread
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.patient import amplitudes
from twinct.uncertainty.sections import PoseNoise, Uncertainty
from twinct.uncertainty.terms.registry import terms_of


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
        total = np.zeros((12, 12))
        for term in self.terms:
            apart = np.array(float(one - other))
            total += term.alike(apart) * term.factor[one] @ term.factor[other].T
        return total

    @cached_property
    def covariances(self) -> Floats:
        """Covariance of the errors within each view, (views, 12, 12)."""
        return sum(
            (term.factor @ np.swapaxes(term.factor, 1, 2) for term in self.terms),
            np.zeros((self.views, 12, 12)),
        )


def first_order(section: Uncertainty, scan: NominalScan) -> FirstOrder:
    """Compute the first-order covariances of a scenario's errors, without draws."""
    slopes = [derivatives(scan.motion(side)) for side in range(2)]
    of_terms, means = _of_terms(section, scan, slopes)
    results = [
        *of_terms,
        *_of_encoders(section, scan, slopes),
        *_of_patient(section, scan),
        *_reported(section),
    ]
    views = len(scan.time_s)
    terms: dict[tuple[str, float], list[Floats]] = {}
    for term in results:
        if term.factor.any():
            factor = np.broadcast_to(term.factor, (views, *term.factor.shape[1:]))
            terms.setdefault((term.name, term.length), []).append(factor)
    joined = tuple(
        Term(name, np.concatenate(parts, axis=2), length) for (name, length), parts in terms.items()
    )
    return FirstOrder(joined, tuple(term for term in means if term.factor.any()), views)


def _of_side(side: int, factor: Floats) -> Floats:
    """Extend a factor of one end-effector, (views, 6, draws), to both, (views, 12, draws)."""
    both = np.zeros((len(factor), 12, factor.shape[2]))
    both[:, 6 * side : 6 * side + 6] = factor
    return both


def _of_terms(
    section: Uncertainty, scan: NominalScan, slopes: list[dict[Place, Floats]]
) -> tuple[list[Term], list[Term]]:
    """Return the effects of all error terms, random and systematic ones."""
    of_views: list[Term] = []
    shared: dict[tuple[str, int], Term] = {}
    for side, whose in enumerate(SIDES):
        for term, settings in terms_of(section, whose):
            spreads = keyed_spreads(term, settings, scan.motion(side))
            for k, (spread, _) in enumerate(spreads):
                factor = _of_side(side, _factor(slopes[side][spread.place], spread))
                if spread.draws in ("each", "side"):
                    of_views.append(Term(term.name, factor, spread.length))
                    continue
                # One draw moves both sides.
                name = f"{term.name}, mean" if spread.draws == "none" else term.name
                before = shared[term.name, k].factor if (term.name, k) in shared else 0.0
                shared[term.name, k] = Term(name, before + factor, spread.length)
    means = [term for term in shared.values() if term.name.endswith(", mean")]
    return [*of_views, *(term for term in shared.values() if term not in means)], means


def _factor(slope: Floats, spread: Spread) -> Floats:
    """Return the errors of one tool per standard draw, (views, 6, draws)."""
    if spread.place == "joints":
        factor = np.swapaxes(slope * by_view(spread)[..., None], 1, 2)
    else:
        sigma = by_view(spread)
        sigma = sigma if spread.place == "links" else sigma[:, None]
        factor = _columns(slope * sigma[..., None, :])
    return factor if spread.draws == "each" else factor.sum(axis=2, keepdims=True)


def _of_encoders(
    section: Uncertainty, scan: NominalScan, slopes: list[dict[Place, Floats]]
) -> Iterator[Term]:
    # Quantisation leaves an error that is uniform over one encoder step.
    step = np.radians(section.encoder_step_deg) / np.sqrt(12)
    for side, joints in enumerate(scan.joints):
        hinges = scan.chains[side].hinges  # rails are read exactly
        spread = Spread("joints", np.broadcast_to(step * hinges, joints.shape), 0.0)
        yield Term("encoder", _of_side(side, _factor(slopes[side]["joints"], spread)), 0.0)


def _columns(factor: Floats) -> Floats:
    """Reshape (views, frames, 6, draws) to (views, 6, frames x draws), without zero columns."""
    flat = np.moveaxis(factor, 1, 2).reshape(len(factor), 6, -1)
    return flat[:, :, flat.any(axis=(0, 1))]


def _of_patient(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    patient = section.patient
    sizes = amplitudes(patient, scan.time_s)  # a random direction has a mean square of 1/3 per axis
    pivot = np.eye(4)
    pivot[:3, 3] = patient.pivot_mm
    both = np.concatenate([carried(np.broadcast_to(pivot, t.shape), t) for t in scan.poses], axis=1)
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
