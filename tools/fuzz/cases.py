"""What a kind of fuzzing is: valid material, and cases that are made of it and tried."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class Case:
    """One thing to try.

    Attributes:
        told: what it is, in words, for who looks into it.
        act: does it and says in a word what came of it; a ``twinct.errors.InputError`` counts as
            refused, whatever else it raises is a finding.
    """

    told: str
    act: Callable[[], str]


class Kind(Protocol):
    """A kind of input. Its module has a class ``Kind``, which ``__main__`` finds by its name.

    Attributes:
        seconds: of the processor that a case may take.
        memory_bytes: that the process may hold at a case's peak.
    """

    seconds: float
    memory_bytes: int

    def __init__(self, material: Path) -> None:
        """Make what all cases start from, in a folder that cases leave as it is."""
        ...

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case in an empty folder; the same numbers from ``rng`` make the same case."""
        ...
