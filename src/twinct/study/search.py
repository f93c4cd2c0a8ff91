"""A search: sets of values asked for in batches, the same again whenever the same is told."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from twinct.extras import require
from twinct.study.design import Choice
from twinct.study.settings import Dimension, Search

Tried = tuple[Mapping[str, Any], float | None]
"""Values by name, and the figure that they gave; None where they failed."""


def asked(search: Search, tried: Sequence[Tried]) -> list[Mapping[str, Any]]:
    """The next batch of values, by the dimensions' names; fewer at the end.

    It depends on the search and on what was tried alone: the sampler (Optuna's TPE) starts anew
    with each batch, seeded by the search's seed and the number of trials before.

    Args:
        search: what is searched.
        tried: all trials before, in the order in which they were asked for.

    Raises:
        MissingExtraError: Optuna is not installed.
    """
    require("study")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    number = min(search.batch, search.trials - len(tried))
    seed = (search.seed * 1_000_003 + len(tried)) % 2**32
    with warnings.catch_warnings():  # that the sampler's option is experimental
        warnings.simplefilter("ignore")
        # In a batch each set keeps away from those that are not judged yet.
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


def choice_of(search: Search, values: Mapping[str, Any]) -> Choice:
    """What a set of values changes."""
    changes = {key: values[d.name] for d in search.keys for key in d.keys}
    return Choice(changes, dict(values))


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
