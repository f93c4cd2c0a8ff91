"""How well a task can be done with some views: predicted detectability at a place.

The reconstruction is the quadratic penalised weighted least-squares one: it minimises
(p - A x)^T D (p - A x) / 2 + beta x^T R x / 2, with D the photons that are expected in each pixel,
which is one over the variance of a line integral, and R the differences of neighbouring voxels. It
is linear; about a voxel j it acts nearly like a filter. With f the Fourier transform of A^T D A e_j
and r that of R e_j,

    MTF = f / (f + beta r),    NPS = f / (f + beta r)^2

(J. A. Fessler, W. L. Rogers, IEEE Trans. Image Process. 5 (1996) 1346; J. W. Stayman, J. A.
Fessler, IEEE Trans. Med. Imaging 23 (2004) 1543; task-driven: G. J. Gang et al., Phys. Med. Biol.
60 (2015) 3031). The non-prewhitening observer of a signal with Fourier transform W has

    d'^2 = [sum |W MTF|^2]^2 / sum |W MTF|^2 NPS.

f is a sum over the views, each with its exposure: that of many choices of views costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.geometry import Floats
from twinct.progress import SILENT, Progress
from twinct.recon import Projector


@dataclass(frozen=True, eq=False)
class Task:
    """A signal that is to be told from nothing, in the middle of a small grid.

    Attributes:
        signal: the difference that it makes, (z, y, x), 1/mm.
        beta: strength of the penalty, mm^2: its R has no unit, its D photons.
    """

    signal: Floats
    beta: float

    def __init__(self, signal: ArrayLike, beta: float) -> None:
        """Copy, check and freeze.

        Raises:
            InputError: no signal, or a penalty that is not positive.
        """
        values = np.array(signal, dtype=np.float64)
        values.setflags(write=False)
        if values.ndim != 3 or not np.isfinite(values).all() or not values.any():
            raise InputError("the signal of a task must be a volume (z, y, x) that is not all 0")
        if not beta > 0:
            raise InputError(f"beta: {beta:g}: it must be positive")
        object.__setattr__(self, "signal", values)
        object.__setattr__(self, "beta", float(beta))


@dataclass(frozen=True, eq=False)
class Detectability:
    """d' of a task as a function of the exposure of each candidate view.

    Attributes:
        task: signal and penalty.
        fisher: f of each view at unit exposure, as ``numpy.fft.rfftn`` orders frequencies,
            (views, z, y, x // 2 + 1), float32.
    """

    task: Task
    fisher: NDArray[np.float32]

    @cached_property
    def _power(self) -> Floats:
        """|W|^2 of the half spectrum; frequencies stand for their mirrored ones as well."""
        shape = self.task.signal.shape
        times = np.full(shape[2] // 2 + 1, 2.0)
        times[0] = 1.0
        if shape[2] % 2 == 0:
            times[-1] = 1.0
        return np.abs(np.fft.rfftn(self.task.signal)) ** 2 * times / self.task.signal.size

    @cached_property
    def _penalty(self) -> Floats:
        """Beta r."""
        z, y, x = self.task.signal.shape
        return self.task.beta * difference_spectrum((z, y, x))

    def __call__(self, exposures: ArrayLike) -> float:
        """D' with an exposure of each view, (views,), 0 where a view is not taken."""
        f = np.tensordot(np.asarray(exposures, dtype=np.float64), self.fisher, axes=1)
        return float(self._of(f))

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """D' of a choice of views with one more, for each of some candidates, (candidates,)."""
        f = self.fisher[list(chosen)].sum(axis=0, dtype=np.float64)
        return np.array([self._of(f + self.fisher[view]) for view in candidates])

    def slopes(self, exposures: ArrayLike) -> Floats:
        """Derivatives of d'^2 with each view's exposure, (views,)."""
        f = np.tensordot(np.asarray(exposures, dtype=np.float64), self.fisher, axes=1)
        known = f > 0
        both = f + self._penalty
        f, both = f[known], both[known]
        power, penalty = self._power[known], self._penalty[known]
        a = (power * (f / both) ** 2).sum()
        b = (power * f**3 / both**4).sum()
        by_f = np.zeros(known.shape)
        gain = 2 * power * f * penalty / both**3
        loss = power * f**2 * (3 * penalty - f) / both**5
        by_f[known] = (2 * a * gain * b - a * a * loss) / b**2
        return np.tensordot(self.fisher, by_f, axes=3)

    def blurred(
        self, views: Sequence[int], sigma: float, exposures: ArrayLike | None = None
    ) -> float:
        """D' of a choice of views where what is there is blurred and the template is not.

        The observer looks for what was to be expected: d' times sum |W MTF|^2 B / sum |W MTF|^2,
        B that of a Gaussian. A blurred template would not only expect less, but also let less noise
        through, and d' might rise.

        Args:
            views: of the choice.
            sigma: of the Gaussian, in voxels.
            exposures: of each of these; None: unit ones.
        """
        each = np.ones(len(views)) if exposures is None else np.asarray(exposures, np.float64)
        f = np.tensordot(each, self.fisher[list(views)], axes=1)
        z, y, x = self.task.signal.shape
        squared = np.fft.fftfreq(z)[:, None, None] ** 2 + np.fft.fftfreq(y)[:, None] ** 2
        blur = np.exp(-2 * (np.pi * sigma) ** 2 * (squared + np.fft.rfftfreq(x) ** 2))
        transfer = self._transfer(np.maximum(f, 0.0))
        seen = self._power * transfer * transfer
        return self._of(f) * float((seen * blur).sum() / seen.sum()) if seen.any() else 0.0

    def _of(self, f: Floats) -> float:
        """D' of f over a whole choice; powers that are still negative, of the grid's end, are 0."""
        f = np.maximum(f, 0.0)
        transfer, both = self._transfer(f), f + self._penalty
        seen = self._power * transfer * transfer
        per_f = np.divide(transfer, both, out=np.zeros_like(f), where=both > 0)
        noise = float((seen * per_f).sum())
        return float(seen.sum() / np.sqrt(noise)) if noise > 0 else 0.0

    def _transfer(self, f: Floats) -> Floats:
        """MTF; of a constant neither views nor penalty may say anything."""
        both = f + self._penalty
        return np.divide(f, both, out=np.zeros_like(f), where=both > 0)


def detectability_of(
    A: Projector,  # noqa: N803 - as in A x = p
    photons: ArrayLike,
    task: Task,
    progress: Progress = SILENT,
) -> Detectability:
    """The detectability of a task in the middle of the projector's grid.

    Args:
        A: of all candidate views, on a grid about the place with the signal's shape and at least
            its blur around it.
        photons: D at unit exposure, (views, rows, columns): what a prior volume lets through.
        task: signal and penalty.
        progress: hears how far it is.

    Raises:
        InputError: shapes that do not fit.
    """
    photons = np.asarray(photons, dtype=np.float32)
    if photons.shape != A.range_shape:
        raise InputError(f"photons of shape {photons.shape}: {A.range_shape} needed")
    if A.domain_shape != task.signal.shape:
        raise InputError(f"the grid has {A.domain_shape} voxels, the signal {task.signal.shape}")
    place = tuple(n // 2 for n in A.domain_shape)
    delta = np.zeros(A.domain_shape, np.float32)
    delta[place] = 1.0
    half = (*A.domain_shape[:2], A.domain_shape[2] // 2 + 1)
    fisher = np.empty((len(A), *half), np.float32)
    with progress.stage("Fisher information", len(A)) as step:
        for view in range(len(A)):
            one = A[view]
            column = one.T(photons[view : view + 1] * one(delta))
            spectrum = np.fft.rfftn(np.roll(column, [-n for n in place], axis=(0, 1, 2)))
            # Even about the place to first order; what is left makes no filter. The negative side
            # lobes of a ray that ends with the grid stay: they cancel in the sum over views.
            fisher[view] = spectrum.real
            step()
    fisher.setflags(write=False)
    return Detectability(task, fisher)


def difference_spectrum(shape: tuple[int, int, int]) -> Floats:
    """r: Fourier transform of R e_j, of differences to the six neighbours, in half."""
    z, y = (2 - 2 * np.cos(2 * np.pi * np.fft.fftfreq(n)) for n in shape[:2])
    x = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(shape[2]))
    return z[:, None, None] + y[None, :, None] + x
