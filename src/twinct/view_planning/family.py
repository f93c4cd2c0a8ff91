"""Search for the best parameters of a family of trajectories: CMA-ES within bounds.

Covariance matrix adaptation (N. Hansen, A. Ostermeier, Evol. Comput. 9 (2001) 159) by the package
``cmaes`` needs no derivatives, and tolerates the jumps of reach and completeness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats

FIRST_SIGMA = 0.3
"""Standard deviation of the first generation, as a share of each parameter's range."""


@dataclass(frozen=True)
class Tuned:
    """Result of a search over parameters.

    Attributes:
        parameters: best set that was tried, by name.
        worth: figure of merit of the best set.
        history: best figure of merit after each generation.
    """

    parameters: Mapping[str, float]
    worth: float
    history: tuple[float, ...]


Worth = Callable[[Sequence[Mapping[str, float]]], Sequence[float]]
"""Figures of merit of a generation of parameter sets; -inf for an infeasible set."""


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
    """Search for the parameters with the largest figure of merit.

    Args:
        worth: evaluates a generation, in any order or at once; see ``Worth``.
        bounds: lowest and highest value of each parameter, by name.
        generations: largest number of generations; the search ends early on convergence.
        population: number of sets per generation; None for CMA-ES's 4 + 3 ln(parameters).
        seed: seed of the draws; equal seeds give equal results.
        start: centre of the first generation; the middle of the bounds by default.
        progress: progress display.

    Raises:
        InputError: invalid bounds, fewer than two parameters, a start outside the bounds, or no
            feasible set.
        MissingExtraError: cmaes is not installed.
    """
    names = list(bounds)
    low, high = (np.array([bounds[name][side] for name in names], float) for side in (0, 1))
    if problems := [
        f"{name}: the bounds {a:g} to {b:g} must be finite and in ascending order"
        for name, a, b in zip(names, low.tolist(), high.tolist(), strict=True)
        if not (np.isfinite([a, b]).all() and a < b)
    ]:
        raise InputError(problems)
    if len(names) < 2:
        raise InputError(f"CMA-ES needs at least two parameters, not {len(names)}")
    middle = np.full(len(names), 0.5)
    if start is not None:
        middle = (np.array([start[name] for name in names], float) - low) / (high - low)
        if outside := [n for n, m in zip(names, middle.tolist(), strict=True) if not 0 <= m <= 1]:
            raise InputError(f"{outside[0]}: {start[outside[0]]:g} lies outside its bounds")
    require("planning")
    from cmaes import CMA

    # Search in shares of the ranges, so that angles and distances have equal weight.
    unit = np.tile([0.0, 1.0], (len(names), 1))
    search = CMA(middle, FIRST_SIGMA, bounds=unit, seed=seed, population_size=population)
    best, most, history = middle, -np.inf, []
    with progress.stage("parameters", generations) as step:
        for _ in range(generations):
            candidates = [search.ask() for _ in range(search.population_size)]
            values = worth([_named(names, low + x * (high - low)) for x in candidates])
            values = np.asarray(values, dtype=np.float64)
            if values.max() > most:
                best, most = candidates[int(values.argmax())], float(values.max())
            history.append(most)
            # Infeasible sets rank below all feasible sets.
            finite = np.where(np.isfinite(values), values, -1e300)
            search.tell(list(zip(candidates, (-finite).tolist(), strict=True)))
            step()
            if search.should_stop():
                break
    if not np.isfinite(most):
        raise InputError(
            f"none of {len(history) * search.population_size} parameter sets within the bounds is "
            "feasible: widen the bounds, or start from a feasible set"
        )
    return Tuned(_named(names, low + best * (high - low)), most, tuple(history))


def _named(names: Sequence[str], values: Floats) -> dict[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
