"""The best parameters of a family of trajectories: CMA-ES within bounds.

Covariance matrix adaptation (N. Hansen, A. Ostermeier, Evol. Comput. 9 (2001) 159) by the package
``cmaes``: it needs no slopes, and takes the steps that reach and completeness have as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twinct.errors import InputError
from twinct.extras import require
from twinct.geometry import Floats
from twinct.progress import SILENT, Progress

FIRST_SIGMA = 0.3
"""Spread of the first generation, as a share of each parameter's range."""


@dataclass(frozen=True)
class Tuned:
    """What a search over parameters found.

    Attributes:
        parameters: the best that was tried, by name.
        worth: theirs.
        history: the best so far after each generation.
    """

    parameters: Mapping[str, float]
    worth: float
    history: tuple[float, ...]


Worth = Callable[[Sequence[Mapping[str, float]]], Sequence[float]]
"""What sets of parameters are worth, a generation at a time; -inf of one that cannot be had."""


def best_parameters(
    worth: Worth,
    bounds: Mapping[str, tuple[float, float]],
    *,
    generations: int = 40,
    population: int | None = None,
    seed: int = 0,
    start: Mapping[str, float] | None = None,
    progress: Progress = SILENT,
) -> Tuned:
    """Search for the parameters that are worth most.

    Args:
        worth: judges a generation, in any order or at once; see ``Worth``.
        bounds: lowest and highest value of each parameter, by name.
        generations: at most; it ends before where the search has converged.
        population: sets of parameters in each; None: 4 + 3 ln(parameters), as CMA-ES takes it.
        seed: of its draws; the same gives the same.
        start: middle of the first generation; of the bounds unless given.
        progress: hears how far it is.

    Raises:
        InputError: bounds that are none, a start outside them, or nothing found that can be had.
        MissingExtraError: cmaes is not installed.
    """
    names = list(bounds)
    low, high = (np.array([bounds[name][side] for name in names], float) for side in (0, 1))
    if problems := [
        f"{name}: bounds {a:g} to {b:g}: the lower one must come first"
        for name, a, b in zip(names, low.tolist(), high.tolist(), strict=True)
        if not (np.isfinite([a, b]).all() and a < b)
    ]:
        raise InputError(problems)
    if len(names) < 2:
        raise InputError(f"{len(names)} parameter: CMA-ES needs two at least")
    middle = np.full(len(names), 0.5)
    if start is not None:
        middle = (np.array([start[name] for name in names], float) - low) / (high - low)
        if outside := [n for n, m in zip(names, middle.tolist(), strict=True) if not 0 <= m <= 1]:
            raise InputError(f"{outside[0]}: {start[outside[0]]:g} lies outside its bounds")
    require("planning")
    from cmaes import CMA

    # The whole search in shares of the ranges: angles and distances count alike.
    unit = np.tile([0.0, 1.0], (len(names), 1))
    search = CMA(middle, FIRST_SIGMA, bounds=unit, seed=seed, population_size=population)
    best, most, history = middle, -np.inf, []
    with progress.stage("parameters", generations) as step:
        for _ in range(generations):
            asked = [search.ask() for _ in range(search.population_size)]
            values = worth([_named(names, low + x * (high - low)) for x in asked])
            values = np.asarray(values, dtype=np.float64)
            if values.max() > most:
                best, most = asked[int(values.argmax())], float(values.max())
            history.append(most)
            # What cannot be had ranks below all that can.
            finite = np.where(np.isfinite(values), values, -1e300)
            search.tell(list(zip(asked, (-finite).tolist(), strict=True)))
            step()
            if search.should_stop():
                break
    if not np.isfinite(most):
        raise InputError(
            f"none of {len(history) * search.population_size} sets of parameters within their "
            "bounds can be had: widen them, or start from one that can"
        )
    return Tuned(_named(names, low + best * (high - low)), most, tuple(history))


def _named(names: Sequence[str], values: Floats) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
