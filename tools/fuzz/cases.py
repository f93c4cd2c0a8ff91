"""Interface of a kind of fuzzing: valid material, and cases made from it."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class Case:
    """One input to try.

    Attributes:
        told: description of the case for the reader of a failure.
        act: runs the case and returns its outcome in a word; an ``InputError`` of twinct counts as
            refused, any other exception is a failure.
    """

    told: str
    act: Callable[[], str]


class Kind(Protocol):
    """A kind of input; its module has a class of this name.

    Attributes:
        seconds: limit of the processor time of a case.
        memory_bytes: limit of the memory peak of the process during a case.
    """

    seconds: float
    memory_bytes: int

    def __init__(self, material: Path) -> None:
        """Make the material of all cases in a folder that cases do not change."""
        ...

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case in an empty folder, determined by ``rng`` alone."""
        ...
