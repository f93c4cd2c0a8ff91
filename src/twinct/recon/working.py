"""The volume that an algorithm works on, where the kernels work: in memory, or on a card."""

from __future__ import annotations

from typing import Any

from twinct.recon.engine import Kernels, Singles


class WorkingVolume:
    """A volume and, for an engine that works on a card, its copy there.

    Attributes:
        held: what the kernels take.
    """

    def __init__(self, kernels: Kernels, x: Singles) -> None:
        """Hand ``x`` (z, y, x) over to the kernels."""
        self._kernels, self._x = kernels, x
        self.held: Any = kernels.hold(x)
        self._changed = False

    def changed(self) -> None:
        """State that kernels have changed what is held."""
        self._changed = True

    @property
    def array(self) -> Singles:
        """The volume in memory, copied from the card at its first use after a change."""
        if self._changed:
            self._kernels.bring(self.held, self._x)
            self._changed = False
        return self._x
