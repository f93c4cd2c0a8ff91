"""Pieces of a search for views, by other processes or this one: what comes back is the same."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from typing import Any, TypeVar

from twinct.pool import Place, Pool, map_over
from twinct.scan import Workshop

GB = 1.5
"""Memory that a piece is taken to need at its peak, GB."""

Piece = TypeVar("Piece")
Found = TypeVar("Found")


def spread(
    function: Callable[[Workshop, Piece], Found],
    workshop: Workshop,
    pieces: Iterable[Piece],
    pool: Pool | None,
) -> Iterator[Found]:
    """``function(workshop, piece)`` of each piece, in their order.

    Args:
        function: one that can be imported by its name.
        workshop: whose scenario goes to the other processes, not what it has built.
        pieces: cut alike whoever does them, as searches for configurations depend on it.
        pool: who does them; None: this process, one after the other.

    Raises:
        InputError: of the first piece that failed for bad input.
        TwinctError: of the first that failed otherwise.
    """
    if pool is None:
        yield from (function(workshop, piece) for piece in pieces)
        return
    scenario = pickle.dumps(workshop.scenario)
    arguments = ((scenario, function, piece) for piece in pieces)
    yield from map_over(_there, arguments, pool=pool, memory_bytes=int(GB * 1e9))


def _there(argument: tuple[bytes, Callable[[Workshop, Any], Any], Any], place: Place) -> Any:
    scenario, function, piece = argument
    return function(_workshop(scenario), piece)


@lru_cache(maxsize=1)
def _workshop(scenario: bytes) -> Workshop:
    """Built once by each worker."""
    return Workshop(pickle.loads(scenario))  # of the process that started this one
