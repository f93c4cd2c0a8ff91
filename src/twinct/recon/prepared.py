"""Preparation that all algorithms share: arguments, memory, the first volume, and the listener."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from twinct.recon.algorithm import Algorithm
from twinct.recon.checks import Checks, start_volume
from twinct.recon.engine import Singles
from twinct.recon.memory import require_memory
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback, Listener


class Prepared(Checks):
    """Checks of an algorithm's arguments; ``done`` also makes sure that the memory suffices.

    Attributes:
        p: line integrals, (views, rows, columns).
        pixels: True where a pixel counts, (rows, columns) or (views, rows, columns), or None.
    """

    def __init__(
        self,
        algorithm: Algorithm[Any],
        A: Projector,
        line_integrals: ArrayLike,
        mask: ArrayLike | None,
    ) -> None:
        """Check line integrals and mask; ``done`` reports the problems."""
        super().__init__(A.range_shape)
        self.p, self.pixels = self.projections(line_integrals, mask)
        self._algorithm, self._A = algorithm, A

    def done(self, more: tuple[float, float] = (0.0, 0.0)) -> None:
        """Raise InputError for problems, or MemoryShortageError.

        Args:
            more: memory beyond the algorithm's own: volumes, and copies of the projections.
        """
        super().done()
        require_memory(self._algorithm, self._A, *more)

    def begin(
        self,
        callback: Callback | None,
        updates: int = 1,
        *,
        x0: ArrayLike | None = None,
        nonnegative: bool = False,
        more: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[Singles, Listener]:
        """Finish the checks; return a copy of ``x0``, or zeros, and the listener.

        Args:
            callback: called after each update.
            updates: updates of a pass.
            x0: initial volume, (z, y, x).
            nonnegative: whether it is clipped at zero.
            more: as for ``done``.

        Raises:
            InputError: arguments have problems.
            MemoryShortageError: the memory does not suffice.
        """
        x0 = self.start(x0, self._A.domain_shape)
        self.done(more)
        return start_volume(self._A, x0, nonnegative), Listener(callback, updates)
