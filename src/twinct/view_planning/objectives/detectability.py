"""Predicted detectability of a task at one place, for a set of views.

The reconstruction is quadratic penalised weighted least squares: it minimises
(p - A x)^T D (p - A x) / 2 + beta x^T R x / 2. D holds the expected photons in each pixel, the
inverse variance of a line integral, and R the differences of neighbouring voxels. The
reconstruction is linear, and around a voxel j it acts nearly like a filter. With the Fourier
transforms f of A^T D A e_j and r of R e_j,

    MTF = f / (f + beta r),    NPS = f / (f + beta r)^2

(J. A. Fessler, W. L. Rogers, IEEE Trans. Image Process. 5 (1996) 1346; J. W. Stayman, J. A.
Fessler, IEEE Trans. Med. Imaging 23 (2004) 1543; task-driven: G. J. Gang et al., Phys. Med. Biol.
60 (2015) 3031). The non-prewhitening observer of a signal with Fourier transform W has

    d'^2 = [sum |W MTF|^2]^2 / sum |W MTF|^2 NPS.

f is a sum over the views, weighted by their exposures. Many choices of views are therefore cheap
to evaluate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.progress import SILENT, Progress
from twinct.core.settings import Positive, setting
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon import Projector
from twinct.specimen.signals import AnySignal, contrast_at
from twinct.view_planning.objectives.objective import MoreIsBetter, Objective, PatientModel, Views

BOX = 32
"""Voxels along an edge of the grid around the signal."""


class DetectabilityGoal(MoreIsBetter):
    """Detectability d' of a signal in the middle of the region: more is better."""

    signal: AnySignal = Field(description="Signal to detect.")
    voxel_mm: Positive = setting(1.0, "Voxel edge of the reconstruction for which it is predicted.")
    penalty: Positive = setting(
        1.0,
        "Strength of the reconstruction's quadratic penalty, relative to what evenly spread "
        "views measure at the signal's frequencies: 1 smooths half of the signal away.",
        unit="1",
    )


@dataclass(frozen=True, eq=False)
class Task:
    """Signal to detect, in the middle of a small grid.

    Attributes:
        signal: difference between signal and background, (z, y, x), 1/mm.
        beta: strength of the penalty, mm^2, because R has no unit and D counts photons.
    """

    signal: Floats
    beta: float

    def __init__(self, signal: ArrayLike, beta: float) -> None:
        """Copy, check and freeze the signal.

        Raises:
            InputError: the signal is no volume or all 0, or the penalty is not positive.
        """
        values = np.array(signal, dtype=np.float64)
        values.setflags(write=False)
        if values.ndim != 3 or not np.isfinite(values).all() or not values.any():
            raise InputError("the signal of a task must be a volume (z, y, x) that is not all 0")
        if not beta > 0:
            raise InputError(f"beta is {beta:g}; it must be positive")
        object.__setattr__(self, "signal", values)
        object.__setattr__(self, "beta", float(beta))


@dataclass(frozen=True, eq=False)
class Detectability:
    """Detectability d' of a task as a function of the exposure of each candidate view.

    Attributes:
        task: signal and penalty.
        fisher: f of each view at unit exposure, frequencies in the order of ``numpy.fft.rfftn``,
            (views, z, y, x // 2 + 1), float32.
    """

    task: Task
    fisher: NDArray[np.float32]

    @cached_property
    def _power(self) -> Floats:
        """Half spectrum of |W|^2, in which frequencies also count for their mirror images."""
        shape = self.task.signal.shape
        times = np.full(shape[2] // 2 + 1, 2.0)
        times[0] = 1.0
        if shape[2] % 2 == 0:
            times[-1] = 1.0
        return np.abs(np.fft.rfftn(self.task.signal)) ** 2 * times / self.task.signal.size

    @cached_property
    def _penalty(self) -> Floats:
        """Spectrum of the penalty, beta r."""
        z, y, x = self.task.signal.shape
        return self.task.beta * difference_spectrum((z, y, x))

    def __call__(self, exposures: ArrayLike) -> float:
        """Return d' for the exposures of all views, (views,), 0 for a view that is not taken."""
        f = np.tensordot(np.asarray(exposures, dtype=np.float64), self.fisher, axes=1)
        return float(self._of(f))

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """Return d' of a choice of views with one more view, for each candidate, (candidates,)."""
        f = self.fisher[list(chosen)].sum(axis=0, dtype=np.float64)
        return np.array([self._of(f + self.fisher[view]) for view in candidates])

    def slopes(self, exposures: ArrayLike) -> Floats:
        """Return the derivatives of d'^2 with respect to each view's exposure, (views,)."""
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
        """Return d' of a choice of views if the signal is blurred and the template is not.

        The observer looks for the expected signal: d' times sum |W MTF|^2 B / sum |W MTF|^2, with
        the transfer function B of a Gaussian. A blurred template would also pass less noise, and d'
        might rise.

        Args:
            views: chosen views.
            sigma: standard deviation of the Gaussian, in voxels.
            exposures: exposure of each chosen view; None for unit exposures.
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
        """Return d' for f of a whole choice; negative values, from the grid's end, count as 0."""
        f = np.maximum(f, 0.0)
        transfer, both = self._transfer(f), f + self._penalty
        seen = self._power * transfer * transfer
        per_f = np.divide(transfer, both, out=np.zeros_like(f), where=both > 0)
        noise = float((seen * per_f).sum())
        return float(seen.sum() / np.sqrt(noise)) if noise > 0 else 0.0

    def _transfer(self, f: Floats) -> Floats:
        """Return the MTF, 0 where neither views nor penalty determine a frequency."""
        both = f + self._penalty
        return np.divide(f, both, out=np.zeros_like(f), where=both > 0)


def detectability_of(
    A: Projector,  # noqa: N803 - as in A x = p
    photons: ArrayLike,
    task: Task,
    progress: Progress = SILENT,
) -> Detectability:
    """Compute the detectability of a task in the middle of the projector's grid.

    Args:
        A: projector of all candidate views, on a grid of the signal's shape around the place, with
            a margin of at least the signal's blur.
        photons: D at unit exposure behind a prior volume, (views, rows, columns).
        task: signal and penalty.
        progress: progress display.

    Raises:
        InputError: shapes do not match.
    """
    photons = np.asarray(photons, dtype=np.float32)
    if photons.shape != A.range_shape:
        raise InputError(f"photons has shape {photons.shape}; it must be {A.range_shape}")
    if A.domain_shape != task.signal.shape:
        raise InputError(
            f"the grid has {A.domain_shape} voxels, but the signal has {task.signal.shape}"
        )
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
            # The column is even about the place to first order; the odd rest makes no filter.
            # Keep the negative side lobes of rays that end with the grid: they cancel in the sum
            # over views.
            fisher[view] = spectrum.real
            step()
    fisher.setflags(write=False)
    return Detectability(task, fisher)


def difference_spectrum(shape: tuple[int, int, int]) -> Floats:
    """Return r, the half spectrum of R e_j, from differences to the six neighbours."""
    z, y = (2 - 2 * np.cos(2 * np.pi * np.fft.fftfreq(n)) for n in shape[:2])
    x = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(shape[2]))
    return z[:, None, None] + y[None, :, None] + x


def _measure(settings: DetectabilityGoal, views: Views, patient: PatientModel) -> Detectability:
    """Return d' of the signal in the middle of the region."""
    place, voxel = views.points[0], settings.voxel_mm
    z, y, x = np.indices((BOX, BOX, BOX)) - BOX // 2
    radius = voxel * np.sqrt(x * x + y * y + z * z)
    signal = contrast_at(settings.signal, radius, voxel) * patient.reference_mu
    # Centre voxel BOX // 2 at the place.
    grid = VolumeGrid((BOX,) * 3, voxel, Pose.from_euler(place - voxel / 2, (0.0, 0.0, 0.0)))
    coarse, photons = patient.photons(views.geometry, place, voxel, "task.detectability")
    result = detectability_of(Projector(coarse, grid), photons, Task(signal, 1.0), views.progress)
    power = np.abs(np.fft.rfftn(signal)) ** 2
    fisher = result.fisher[list(views.even)].sum(axis=0, dtype=np.float64)
    beta = settings.penalty * float(
        (power * fisher).sum() / (power * difference_spectrum((BOX, BOX, BOX))).sum()
    )
    if not beta > 0:
        raise InputError(
            "task.detectability: views spread evenly over all reachable ones carry no information "
            "on the signal, as only few see it (task.position_mm)"
        )
    return Detectability(Task(signal, beta), result.fisher)


def _blurred(
    settings: DetectabilityGoal,
    measure: Detectability,
    views: Sequence[int],
    blur_mm: float,
    exposures: Floats,
) -> float:
    return measure.blurred(views, blur_mm / settings.voxel_mm, exposures)


DETECTABILITY = Objective(
    "detectability",
    DetectabilityGoal,
    _measure,
    "Favour the detectability of a signal.",
    under_errors=_blurred,
)
