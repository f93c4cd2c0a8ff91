"""A cause of line integrals that contradict each other, and what a scan says of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from twinct.diagnosis.coarse import Coarse
from twinct.recon.engine import Singles

Signatures = Callable[[Coarse], Iterator[Singles]]
"""Function of a coarse scan that yields the derivatives of its line integrals by a cause's numbers.

Each is an array (views, rows, columns), up to a factor. There are none if the scan rules it out.
"""


@dataclass(frozen=True)
class Cause:
    """A model of few numbers of how measured line integrals differ from those of any volume.

    Attributes:
        name: its name, one word.
        signatures: derivatives by its numbers.
        geometric: whether it lies in the geometry: a volume takes over little of its signatures,
            so that products of these with the residual tell whether they matter.
        by_view: whether each view has numbers of its own.
    """

    name: str
    signatures: Signatures
    geometric: bool = False
    by_view: bool = False
