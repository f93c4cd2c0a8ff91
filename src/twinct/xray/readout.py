"""Conversion of a pixel's signal to a grey value, and correction of the resulting images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import InputError

Pixels = TypeVar("Pixels", NDArray[np.float32], NDArray[np.float64])


@dataclass(frozen=True)
class Amplifier:
    """Amplifier and converter.

    Attributes:
        gain: grey values per unit of signal.
        offset: grey value without signal.
        bits: bit depth; None keeps fractions and has no upper limit.
        saturation: grey value at which a pixel saturates; None: the converter's maximum.
    """

    gain: float = 1.0
    offset: float = 0.0
    bits: int | None = None
    saturation: float | None = None

    @property
    def largest(self) -> float:
        """Largest possible grey value."""
        largest = np.inf if self.bits is None else float(2**self.bits - 1)
        return largest if self.saturation is None else min(self.saturation, largest)

    def read(self, signal: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return grey values, (rows, columns); non-negative integers if there is a bit depth."""
        raw = signal * np.float32(self.gain) + np.float32(self.offset)
        if self.bits is not None:
            np.rint(raw, out=raw)
            np.maximum(raw, np.float32(0), out=raw)
        if np.isfinite(self.largest):
            np.minimum(raw, np.float32(self.largest), out=raw)
        return raw


def binned(image: Pixels, across: int, down: int | None = None) -> Pixels:
    """Return means of blocks of pixels, ``across`` along u and ``down`` (or ``across``) along v."""
    down = across if down is None else down
    if across == down == 1:
        return image
    rows, columns = image.shape
    blocks = image.reshape(rows // down, down, columns // across, across)
    return blocks.mean(axis=(1, 3), dtype=image.dtype)


def mend_bad_pixels(image: NDArray[np.float32], bad: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill known bad pixels with the mean of good neighbours; larger holes are filled inwards."""
    if not bad.any():
        return image
    if bad.all():
        raise InputError("every pixel is bad")
    mended, good = np.where(bad, np.float32(0), image), ~bad
    around = np.ones((3, 3), dtype=np.float32)
    while not good.all():
        count = scipy.ndimage.convolve(good.astype(np.float32), around, mode="constant")
        known = np.where(good, mended, np.float32(0))
        total = scipy.ndimage.convolve(known, around, mode="constant")
        now = ~good & (count > 0)
        mended[now] = total[now] / count[now]
        good = good | now
    return mended


def correct(
    raw: NDArray[np.float32],
    flat: NDArray[np.float32],
    dark: NDArray[np.float32] | float,
    floor: float = 0.5,
) -> NDArray[np.float32]:
    """Return the transmission by flat and dark images: (raw - dark) / (flat - dark).

    ``floor`` is the smallest difference from the dark image that counts as signal. Darker values
    are set to it, so that every line integral is finite. A converter cannot distinguish half a grey
    value from zero.
    """
    light = np.maximum(raw - dark, np.float32(floor))
    return (light / np.maximum(flat - dark, np.float32(floor))).astype(np.float32)
