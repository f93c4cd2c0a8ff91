"""Kinds of specimen part that other packages offer, by the entry points ``twinct.parts``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from twinct.core.settings import Section, kind_of


class PartSettings(Section):
    """Keys of one kind of part; ``kind`` is a Literal of its name."""


@dataclass(frozen=True, eq=False)
class PartKind:
    """Kind of part that a scenario can name. Images, truth and hull follow from its surface.

    Attributes:
        settings: class of its keys.
        surface: vertices (n, 3), mm, in the part's frame, and triangles (m, 3) of closed bodies,
            counter-clockwise seen from outside.
    """

    settings: type[PartSettings]
    surface: Callable[[Any], tuple[ArrayLike, ArrayLike]]

    @property
    def name(self) -> str:
        """Name of the kind, the value of the key ``kind``."""
        return kind_of(self.settings)
