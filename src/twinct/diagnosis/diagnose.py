"""Causes that a scan's projections name themselves, ranked by what each of them explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.diagnosis.causes import CAUSES
from twinct.diagnosis.coarse import Coarse
from twinct.diagnosis.facts import facts
from twinct.diagnosis.shares import Residual, Share
from twinct.diagnosis.trials import tried
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector

LEAST_SHARE, LEAST_SIGMAS = 0.05, 3.0
"""Share, and its ratio to its standard error, from which a cause is named."""

LEAST_EXPLAINED = 0.006
"""Least that it then explains of the line integrals: coarse voxels leave this of soft objects."""

LARGE = 0.15
"""Share from which a cause is named in any case, such as a motion in few of the views."""

RIVAL = 0.5
"""Share relative to the first cause's, from which another one is named beside it."""

ALIKE = 0.8
"""Ratio of two shares from which they are alike."""

VALUES = tuple(cause.name for cause in CAUSES if not cause.geometric)
"""Causes that change the values of pixels."""

MORE = 2
"""Most causes that are named after the first."""

FEWEST_VIEWS = 10
"""Number of views from which parts of them judge each other."""


@dataclass(frozen=True)
class Diagnosis:
    """Causes by what they explain.

    Attributes:
        named: causes that explain more than chance does, the likeliest first; each after those
            before it explained what they can.
        all: shares of all causes, each on its own, the largest first.
    """

    named: tuple[Share, ...]
    all: tuple[Share, ...]


def diagnosed(
    A: Projector,
    line_integrals: Singles,
    mask: Mask | None = None,
    photons: NDArray[np.float64] | None = None,
) -> Diagnosis:
    """Return the likely causes of line integrals that contradict each other.

    Args:
        A: the projector, as the scan is stated.
        line_integrals: p, (views, rows, columns).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        photons: photons of a pixel in the free beam, (views,), infinite without noise; by default
            air shows the noise.
    """
    if len(A) < FEWEST_VIEWS:
        return Diagnosis((), ())
    scan = Coarse.of(A, line_integrals, mask, photons)
    rest = Residual.of(scan, CAUSES)
    return ranked(rest, tried(scan), list(facts(scan)))


def ranked(rest: Residual, others: tuple[Share, ...], seen: Sequence[str]) -> Diagnosis:
    """Return the diagnosis.

    Args:
        rest: the residual, and the signatures of causes.
        others: shares of causes that were tried.
        seen: names of causes that the images show.
    """
    every = [*(rest.share(cause.name) for cause in CAUSES), *others]
    every.sort(key=lambda one: -one.share)
    named = _explaining(rest, every)
    shown = [one for one in every if one.name in seen]
    # Stuck pixels and missing parts change values, too: they come before causes that only infer it.
    # But metal starves pixels.
    inferred = [n for n, one in enumerate(named) if one.name in VALUES and one.name != "metal"]
    at = min([*inferred, len(named)])
    later = [one for one in named[at:] if one.name not in seen]
    before = [one for one in named[:at] if one.name not in seen]
    return Diagnosis((*before, *shown, *later), tuple(every))


def _explaining(rest: Residual, every: list[Share]) -> list[Share]:
    """Return the cause that explains most, and those that explain what it leaves."""
    sure = _sure(every)
    if not sure:
        return []
    if sure[0].name == "order":
        return sure[:1]  # nothing else means anything then
    sure = [one for one in sure if one.name != "order"]
    first = _simplest([one for one in sure if one.share >= ALIKE * sure[0].share])
    linear = [cause.name for cause in CAUSES if not cause.by_view and cause.name != first.name]
    after = (first.name,) if first.name in rest.owners else ()
    further = _sure([rest.share(name, after) for name in linear])
    rivals = [one for one in sure if one is not first and one.share >= RIVAL * first.share]
    others = {one.name: one for one in (*further, *rivals)}
    return [first, *others.values()][: MORE + 1]


def _sure(shares: list[Share]) -> list[Share]:
    """Return the shares that chance does not explain, the largest first."""

    def is_sure(one: Share) -> bool:
        by_chance = one.share < LEAST_SHARE or one.sigmas < LEAST_SIGMAS
        small = by_chance or one.explained < LEAST_EXPLAINED
        return one.share >= LARGE or not small

    return sorted(filter(is_sure, shares), key=lambda one: -one.share)


def _simplest(alike: list[Share]) -> Share:
    """Return the first of the causes in their order; a wider grid explains many a little."""
    order = [*(cause.name for cause in CAUSES), *(one.name for one in alike)]
    return min(alike, key=lambda one: order.index(one.name))
