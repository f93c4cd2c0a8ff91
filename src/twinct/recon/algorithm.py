"""Algorithms: settings, function, memory needs, and support for resuming.

Each algorithm's file ends with its ``Algorithm``. Algorithms from outside the package come from
the entry points of the group ``twinct.algorithms``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from inspect import signature
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from twinct.core.settings import Section
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback
from twinct.recon.volume import Volume


class AlgorithmSettings(Section):
    """Keys of one algorithm; ``algorithm`` is a Literal of its name, and defaults to it.

    A key named ``path``, ``file`` or ``plan`` is an input file: its path is made absolute, it must
    exist, and its content counts.
    """


@dataclass(frozen=True, eq=False)
class Problem:
    """Input of a reconstruction.

    Attributes:
        projector: A, with the geometry and the grid.
        line_integrals: p, (views, rows, columns), corrected.
        transmission: I/I0 as measured, same shape; see ``counts``.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        x0: initial volume, (z, y, x).
        rng: generator or seed for random draws.
        callback: called after each update; see ``Step``.
        preparing: called after each update that precedes the first pass.
        exposures: mAs of each view, (views,), in one unit for all; None: equal exposures.
        photons: photons of a pixel in the free beam, by view, (views,); None: unknown.
        alone: the line integrals are those of the grid, without its surroundings.
        predicted_views: views whose line integrals an algorithm that removes the surroundings
            itself adds to the volume's extras, as ``predicted``, (views, rows, columns).
    """

    projector: Projector
    line_integrals: NDArray[np.float32]
    transmission: NDArray[np.float32]
    mask: NDArray[np.bool_] | None = None
    x0: NDArray[np.float32] | None = None
    rng: np.random.Generator | int = 0
    callback: Callback | None = None
    preparing: Callback | None = None
    exposures: NDArray[np.float64] | None = None
    photons: NDArray[np.float64] | None = None
    alone: bool = False
    predicted_views: Sequence[int] = ()

    @property
    def counts(self) -> NDArray[np.float32]:
        """Signal of each pixel, for weights: transmission times the view's exposure."""
        if self.exposures is None:
            return self.transmission
        return self.transmission * self.exposures[:, None, None].astype(np.float32)


SettingsT = TypeVar("SettingsT", bound=AlgorithmSettings)


@dataclass(frozen=True, eq=False)
class Algorithm(Generic[SettingsT]):
    """Algorithm that a scenario can name.

    Attributes:
        settings: class of its keys; ``iterations`` is the number of passes, 1 without this key.
        solve: reconstructs a problem with these settings.
        volumes: peak memory in float32 volumes, besides ``x0``.
        projections: peak memory in float32 copies of the projections, besides the input.
        resumes: n iterations, then m from their result as ``x0``, equal n + m, to the last bit.
        masks: the algorithm can leave pixels out; otherwise a mask is refused.
        updates: updates per pass, from settings and number of views, for the progress.
        prepares: likewise, about the number of updates that precede the first pass.
        check: raises InputError, before any work, for keys, their files, views or a grid that the
            algorithm cannot work with.
        extra: memory in addition to ``volumes`` and ``projections``, from the settings: volumes,
            and copies of the projections.
        expects: expected volume, (z, y, x), from A, p, the mask and the settings, if the algorithm
            knows it beforehand; it improves the estimate of the grid's surroundings.
    """

    settings: type[SettingsT]
    solve: Callable[[Problem, SettingsT], Volume]
    volumes: float
    projections: float = 0.0
    resumes: bool = False
    masks: bool = True
    updates: Callable[[SettingsT, int], int] = field(default=lambda settings, views: 1)
    prepares: Callable[[SettingsT, int], int] = field(default=lambda settings, views: 0)
    check: Callable[[SettingsT, ScanGeometry, VolumeGrid], object] = field(
        default=lambda own, views, grid: None
    )
    extra: Callable[[SettingsT], tuple[float, float]] = field(default=lambda settings: (0.0, 0.0))
    expects: Callable[[Projector, Singles, Mask | None, SettingsT], Singles] | None = None

    @property
    def name(self) -> str:
        """Name of the algorithm, the value of the key ``algorithm``."""
        return str(self.settings.model_fields["algorithm"].default)


def solve_by(
    function: Callable[..., Volume], problem: Problem, settings: AlgorithmSettings, **others: Any
) -> Volume:
    """Call an algorithm's function with arguments from problem and settings, by name."""
    A = problem.projector
    given = {**vars(problem), **vars(settings), "A": A, "geometry": A.geometry, "grid": A.grid}
    given |= others
    return function(**{name: given[name] for name in signature(function).parameters})
