"""Point spread of the detector: a filter by its modulation transfer function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.tables import read_columns
from twinct.geometry import Floats

_FREQUENCIES = 512
"""Frequencies along each half axis, for an integral over frequencies."""
MOST_MODULATION = 1.05
"""Maximum modulation: measured tables exceed 1 by their noise, sharpening filters by more."""
CUT_OFF = 0.1
"""Maximum modulation at a table's end below the Nyquist frequency: an edge rings by 0.3 %."""


@dataclass(frozen=True)
class PointSpreadFunction:
    """Rotationally symmetric point spread.

    Attributes:
        mtf: function from spatial frequency in 1/mm (cycles) to modulation, 1 at 0.
        reach_mm: radius of the point spread; the image is mirrored this far beyond its edges.
        end_per_mm: last frequency of a table, beyond which the modulation is taken as 0.
    """

    mtf: Callable[[Floats], Floats]
    reach_mm: float
    end_per_mm: float = np.inf

    @classmethod
    def gaussian(cls, sigma_mm: float) -> PointSpreadFunction:
        """Return a Gaussian.

        Behind a Gaussian, two thin wires of diameter and gap d dip by 20 % at d = sqrt(2) sigma. So
        the basic spatial resolution of ISO 19232-5 is 1.41 sigma, without the pixel's part.
        """
        return cls(lambda f: np.exp(-2 * (np.pi * sigma_mm * f) ** 2), 5 * sigma_mm)

    @classmethod
    def tabulated(
        cls, frequencies_per_mm: Floats, modulation: Floats, reach_mm: float = 5.0
    ) -> PointSpreadFunction:
        """Interpolate linearly between the rows of a table, 0 beyond its last frequency.

        Raises:
            InputError: the frequencies do not rise from 0, or the modulation at 0 is not 1.
        """
        frequencies = np.asarray(frequencies_per_mm, dtype=float)
        values = np.asarray(modulation, dtype=float)
        problems = []
        if frequencies[0] != 0 or abs(values[0] - 1) > 1e-6:
            problems.append(
                "an MTF must start with frequency 0 and modulation 1, not with "
                f"{frequencies[0]:g} and {values[0]:g}"
            )
        if (np.diff(frequencies) <= 0).any():
            problems.append("the frequencies of an MTF must rise")
        if problems:
            raise InputError(problems)
        return cls(
            lambda f: np.interp(f, frequencies, values, right=0.0), reach_mm, float(frequencies[-1])
        )

    @classmethod
    def read(cls, path: Path) -> PointSpreadFunction:
        """Read two columns of text: frequency in 1/mm, modulation from 0 to ``MOST_MODULATION``.

        Raises:
            InputError: the file holds no such table; names the file.
        """
        frequencies, values = read_columns(path, 2)
        problems: list[str] = []
        if values.min() < 0 or values.max() > MOST_MODULATION:
            wrong = values.min() if values.min() < 0 else values.max()
            problems.append(
                f"a modulation is {wrong:g}; it must lie between 0 and {MOST_MODULATION:g}"
            )
        try:
            made = cls.tabulated(frequencies, values)
        except InputError as error:
            problems += error.problems
        else:
            if not problems:
                return made
        raise InputError([f"{path}: {problem}" for problem in problems])

    def check_end(self, pitch_mm: float) -> None:
        """Raise an error if a table ends where its modulation still matters: edges would ring.

        Raises:
            InputError: the table ends below the pitch's Nyquist frequency and above ``CUT_OFF``.
        """
        nyquist = 0.5 / pitch_mm
        last = float(self.mtf(np.array(self.end_per_mm)))
        if self.end_per_mm < nyquist and last > CUT_OFF:
            raise InputError(
                f"the MTF ends at {self.end_per_mm:g}/mm with a modulation of {last:g}; it must "
                f"extend to the pixels' Nyquist frequency, {nyquist:g}/mm, or fall to {CUT_OFF:g}"
            )

    def apply(
        self, image: NDArray[np.float32], pitch_u: float, pitch_v: float
    ) -> NDArray[np.float32]:
        """Return the blurred image (rows, columns); its sum is kept, except at the edges."""
        rows, columns = image.shape
        pad_v = min(int(np.ceil(self.reach_mm / pitch_v)), rows - 1)
        pad_u = min(int(np.ceil(self.reach_mm / pitch_u)), columns - 1)
        shape = _fast(rows + 2 * pad_v), _fast(columns + 2 * pad_u)
        pads = (pad_v, shape[0] - rows - pad_v), (pad_u, shape[1] - columns - pad_u)
        padded = np.pad(image, pads, mode="symmetric")
        spectrum = np.asarray(scipy.fft.rfft2(padded))
        spectrum *= _transfer(self, shape, pitch_u, pitch_v)
        spread = np.asarray(scipy.fft.irfft2(spectrum, s=shape, overwrite_x=True))
        return spread[pad_v : pad_v + rows, pad_u : pad_u + columns].astype(np.float32, copy=False)

    def noise_gain(self, pitch_u: float, pitch_v: float) -> float:
        """Return the standard deviation of white noise of deviation 1 after the point spread.

        It is the root of the mean square of the modulation up to the Nyquist frequencies
        (Parseval).
        """
        half = (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES / 2
        f = np.hypot(half[:, None] / pitch_v, half[None, :] / pitch_u)
        return float(np.sqrt(np.mean(self.mtf(f) ** 2)))


def _fast(length: int) -> int:
    """Return the next length for which the transform is fast."""
    return int(scipy.fft.next_fast_len(length, real=True) or length)


@lru_cache(maxsize=1)  # a scan uses one filter
def _transfer(
    spread: PointSpreadFunction, shape: tuple[int, int], pitch_u: float, pitch_v: float
) -> NDArray[np.float32]:
    along_u, along_v = scipy.fft.rfftfreq(shape[1], pitch_u), scipy.fft.fftfreq(shape[0], pitch_v)
    return spread.mtf(np.hypot(along_v[:, None], along_u[None, :])).astype(np.float32)
