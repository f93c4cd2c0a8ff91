"""Distribution of a search for views over processes, without influence on its results."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any, TypeVar

from twinct.scan import SimulationBuilder
from twinct.workers import Place, Pool

GB = 1.5
"""Assumed peak memory of a piece, GB."""

Piece = TypeVar("Piece")
Found = TypeVar("Found")


def spread(
    function: Callable[[SimulationBuilder, Piece], Found],
    builder: SimulationBuilder,
    pieces: Iterable[Piece],
    pool: Pool | None,
) -> Iterator[Found]:
    """Yield ``function(builder, piece)`` for each piece, in order.

    Args:
        function: a function that can be imported by its name.
        builder: only its scenario is sent to the other processes, none of its built parts.
        pieces: pieces of work, cut independently of the pool, as searches for configurations
            depend on the cut.
        pool: processes that do the work; None: this process, one piece after the other.

    Raises:
        InputError: the first piece to fail had bad input.
        TwinctError: the first piece to fail had another problem.
    """
    if pool is None:
        yield from (function(builder, piece) for piece in pieces)
        return
    scenario = pickle.dumps(builder.scenario)
    arguments = ((scenario, function, piece) for piece in pieces)
    yield from pool.map(_there, arguments, memory_bytes=int(GB * 1e9))


def _there(
    argument: tuple[bytes, Callable[[SimulationBuilder, Any], Any], Any], place: Place
) -> Any:
    scenario, function, piece = argument
    return function(_builder(scenario), piece)


@lru_cache(maxsize=1)
def _builder(scenario: bytes) -> SimulationBuilder:
    """Build the builder once in each worker."""
    return SimulationBuilder(pickle.loads(scenario))  # safe: sent by the parent process
