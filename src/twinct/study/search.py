"""Search for the best values: batches of sets that depend on the earlier results only."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from twinct.core.extras import require
from twinct.study.design import Trial
from twinct.study.settings import Dimension, Search

Tried = tuple[Mapping[str, Any], float | None]
"""Values by name, and their figure; None if the trial failed."""


def next_values(search: Search, tried: Sequence[Tried]) -> list[Mapping[str, Any]]:
    """Return the next batch of values, by the dimensions' names; the last one may be smaller.

    The batch depends only on the search and the earlier trials: the sampler (Optuna's TPE) is
    created for each batch, seeded by the search's seed and the number of earlier trials.

    Args:
        search: settings of the search.
        tried: all earlier trials, in the order in which they were requested.

    Raises:
        MissingExtraError: Optuna is not installed.
    """
    require("study")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    number = min(search.batch, search.trials - len(tried))
    seed = (search.seed * 1_000_003 + len(tried)) % 2**32
    with warnings.catch_warnings():  # the sampler's option is experimental
        warnings.simplefilter("ignore")
        # constant_liar spreads the sets of a batch, as they have no figures yet.
        sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
    study = optuna.create_study(sampler=sampler, direction=search.direction)
    ranges = {dimension.name: _distribution(dimension) for dimension in search.keys}
    for values, figure in tried:
        state = optuna.trial.TrialState
        study.add_trial(
            optuna.trial.create_trial(
                params=dict(values),
                distributions=ranges,
                value=figure,
                state=state.FAIL if figure is None else state.COMPLETE,
            )
        )
    return [study.ask(ranges).params for _ in range(max(number, 0))]


def trial_of(search: Search, values: Mapping[str, Any]) -> Trial:
    """Return a set of values as a trial, which has no number yet."""
    changes = {key: values[d.name] for d in search.keys for key in d.keys}
    return Trial(0, dict(values), changes)


def _distribution(dimension: Dimension) -> Any:
    from optuna.distributions import (
        CategoricalDistribution,
        FloatDistribution,
        IntDistribution,
    )

    if dimension.choices is not None:
        return CategoricalDistribution(dimension.choices)
    assert dimension.low is not None and dimension.high is not None
    log = dimension.scale == "log"
    if dimension.whole:
        return IntDistribution(round(dimension.low), round(dimension.high), log=log)
    return FloatDistribution(dimension.low, dimension.high, log=log)
