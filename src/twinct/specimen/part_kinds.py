"""Kinds of specimen part that other packages offer, by the entry points ``twinct.parts``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from twinct.core.settings import Section, kind_of
from twinct.geometry.bodies import Solid, Voxels


class PartSettings(Section):
    """Keys of one kind of part; ``kind`` is a Literal of its name."""


@dataclass(frozen=True, eq=False)
class PartKind:
    """Kind of part that a scenario can name. Exactly one of its three functions is given.

    Attributes:
        settings: class of its keys.
        surface: vertices (n, 3), mm, in the part's frame, and triangles (m, 3) of closed bodies,
            counter-clockwise seen from outside. X-ray engines render them, and truth and hull
            follow from them.
        voxels: ``geometry.bodies.Voxels``, which are cast as they are.
        solid: ``geometry.bodies.Solid``: path lengths, truth and surface by its own formulas.
    """

    settings: type[PartSettings]
    surface: Callable[[Any], tuple[ArrayLike, ArrayLike]] | None = None
    voxels: Callable[[Any], Voxels] | None = None
    solid: Callable[[Any], Solid] | None = None

    def __post_init__(self) -> None:
        """Check that there is one function.

        Raises:
            ValueError: there are none or several.
        """
        if sum(one is not None for one in (self.surface, self.voxels, self.solid)) != 1:
            raise ValueError(f"part kind {self.name!r} needs one of surface, voxels and solid")

    @property
    def name(self) -> str:
        """Name of the kind, the value of the key ``kind``."""
        return kind_of(self.settings)
