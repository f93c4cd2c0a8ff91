"""One end-effector of one or of many machines, with random errors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from twinct.core.draws import scan_rng
from twinct.core.errors import InputError
from twinct.geometry import Chain, Floats, Misfit
from twinct.uncertainty.error_terms import (
    CONSTANT,
    ArmShift,
    ErrorTerm,
    Spread,
    ToolMotion,
    ViewDraws,
)


class ConstantDraws:
    """Draws of one arm that are constant over a scan; the first scan has those of its seed."""

    def __init__(self, seed: int, side: str, count: int) -> None:
        """Store the key of the draws, and the number of scans."""
        self.count, self._seed, self._side = count, seed, side

    def rng(self, purpose: str) -> np.random.Generator:
        """Return the generator of a purpose."""
        return scan_rng(self._seed, f"{self._side} arm {purpose}")


class DrawnTool:
    """One end-effector with drawn errors; the draws are the first axis.

    Args:
        terms: error terms with their settings.
        side: ``source`` or ``detector``.
        chain: nominal arm; None with a gantry.
        arms_seed: seed of the errors that are constant over a scan.
        draws: number of machines; the first one equals that of a scan with this seed.
    """

    def __init__(
        self,
        terms: Iterable[tuple[ErrorTerm, Any]],
        side: str,
        chain: Chain | None,
        arms_seed: int,
        draws: int = 1,
    ) -> None:
        """Draw the errors that are constant over a scan."""
        self._seed, self._draws = arms_seed, draws
        self._constant: dict[str, Floats] = {}
        own = ConstantDraws(arms_seed, side, draws)
        self._terms: list[tuple[ErrorTerm, Any, ArmShift | None]] = []
        for term, settings in terms:
            if term.drawn is None:
                self._terms.append((term, settings, None))
            elif chain is not None:
                self._terms.append((term, settings, term.drawn(settings, chain, own)))

    def deviations(
        self, motion: ToolMotion, of_views: ViewDraws
    ) -> tuple[list[Misfit], list[Floats]]:
        """Return deviations of the arm at some views, and twists (v, w) of the executed poses.

        The twists are in the tool's axes, (draws, views, 6), mm and rad.
        """
        misfits: list[Misfit] = []
        twists: list[Floats] = []
        for term, settings, drawn in self._terms:
            if drawn is not None:
                misfits.append(drawn(motion, of_views))
                continue
            for spread, purpose in keyed_spreads(term, settings, motion):
                value = self._drawn(spread, purpose, motion, of_views)
                if value is None:
                    continue
                if spread.place == "pose":
                    twists.append(value)
                else:
                    own: Any = {spread.place: (value,) if spread.place == "joints" else value}
                    misfits.append(Misfit(**own))
        return misfits, twists

    def executed(
        self, motion: ToolMotion, of_views: ViewDraws
    ) -> tuple[Floats | None, list[Floats]]:
        """Return ``world_from_tool`` of the deviating arm, and the twists of its executed poses.

        The twists are not in the poses, (draws or 1, views, 4, 4), mm. They are None without an
        arm, or if it does not deviate.
        """
        misfits, twists = self.deviations(motion, of_views)
        if motion.chain is None or not any(misfits):
            return None, twists
        return motion.chain.tools(motion.joints, *misfits), twists

    def _drawn(
        self, spread: Spread, purpose: str, motion: ToolMotion, of_views: ViewDraws
    ) -> Floats | None:
        """Return the deviations of one spread, (draws, views or 1, ...); None outside a scan."""
        sigma = by_view(spread)
        if spread.draws == "none":
            return sigma[None]
        joints = motion.joints.shape[1]
        whole = {"joints": (joints,), "links": (joints, 6)}.get(spread.place, (6,))
        shape = whole if spread.draws == "each" else (1,) * len(whole)
        if spread.length == CONSTANT:
            if purpose not in self._constant:
                rng = scan_rng(self._seed, purpose)
                self._constant[purpose] = rng.normal(size=(self._draws, *shape))
            return sigma * self._constant[purpose][:, None]
        normals = of_views(purpose, int(np.prod(shape)), spread.length)
        if normals is None:
            return None
        values = normals.reshape(*normals.shape[:2], *shape)
        return (sigma.astype(values.dtype) * values).astype(float)


def keyed_spreads(
    term: ErrorTerm, settings: Any, motion: ToolMotion
) -> Iterator[tuple[Spread, str]]:
    """Yield the spreads of a term, each with the key of its draws.

    Raises:
        InputError: a spread has a place that the term does not declare; or a term of arms applies
            to a gantry.
    """
    places: Counter[str] = Counter()
    for spread in term.spreads(settings, motion):
        key = f"uncertainty.{term.section or term.name}"
        if spread.place not in term.places:
            declared = ", ".join(term.places)
            raise InputError(
                f"{key}: a spread of this error has the place {spread.place!r}, but the error "
                f"declares only {declared}"
            )
        if motion.chain is None and spread.place != "pose":
            raise InputError(f"{key}: this error belongs to arms, and a gantry has none")
        places[spread.place] += 1
        again = "" if places[spread.place] == 1 else f" {places[spread.place]}"
        whose = "both" if spread.draws == "all" else motion.side
        if spread.place == "pose":
            yield spread, f"{term.purpose or term.name} {whose}{again}"
        else:
            yield spread, f"{whose} arm {term.name} {spread.place}{again}"


def by_view(spread: Spread) -> Floats:
    """Return the standard deviations with an axis of views first."""
    sigma, axes = np.asarray(spread.sigma, np.float64), 3 if spread.place == "links" else 2
    return sigma.reshape((1,) * (axes - sigma.ndim) + sigma.shape)
