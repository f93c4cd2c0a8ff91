"""Conversion of collected energy to grey values, as the file describes the detector.

Grey values follow from, in this order of precedence, the intensity file, ``factor`` and ``offset``
(both apply to the energy a pixel collects, in J), or ``imin`` and ``imax``: linear, with ``imax``
at the brightest pixel of the free beam in frame 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.images import read_image
from twinct.core.files.tables import read_curve
from twinct.ctsimu.scene import PanelResponse
from twinct.geometry import Floats, Panel
from twinct.xray.spread import PointSpreadFunction

Image = NDArray[np.float64]

MTF_REACH_MM = 5.0
"""Radius up to which a point spread from an MTF is computed."""


@dataclass(frozen=True)
class Digitiser:
    """Detector for images without binning.

    ``free_beam_j`` is the energy in the brightest pixel of the free beam in frame 0.
    """

    response: PanelResponse
    panel: Panel
    free_beam_j: float

    def grey(self, energy_j: Image) -> Image:
        """Return mean grey values for the pixels' energies, J; neither rounded nor clipped."""
        response = self.response
        if response.curve is not None:
            return _extended(energy_j, *read_curve(response.curve))
        if response.factor is not None and response.offset is not None:
            return response.factor * energy_j + response.offset
        return response.imin + (response.imax - response.imin) * (energy_j / self.free_beam_j)

    @property
    def brightest(self) -> float:
        """Grey value of the brightest pixel of the free beam in frame 0."""
        return float(self.grey(np.array([self.free_beam_j]))[0])

    def deviation(self, grey: Image) -> Image | None:
        """Return the standard deviation of one frame's noise in grey values; None without noise.

        The noise file has precedence. Otherwise quantum noise is assumed: its SNR grows with the
        square root of the intensity.
        """
        response = self.response
        if response.noise is not None:
            ratio = np.interp(grey, *read_curve(response.noise))
            return np.where(ratio > 0, np.abs(grey) / np.where(ratio > 0, ratio, 1.0), 0.0)
        if response.snr is None:
            return None
        dark = float(self.grey(np.zeros(1))[0])
        share = np.clip((grey - dark) / (self.brightest - dark), 0.0, None)
        return self.brightest / response.snr * np.sqrt(share)

    def blurred(self, image: Image) -> Image:
        """Convolve an image with the point spread; the image is mirrored beyond its border."""
        spread, panel = self._spread(), self.panel
        if spread is None:
            return image
        # float32 suffices for the image, but not for energies of 1e-9 J.
        level = float(image.max()) or 1.0
        relative = (image / level).astype(np.float32)
        return spread.apply(relative, panel.pitch_u, panel.pitch_v).astype(np.float64) * level

    def noise(self, rng: np.random.Generator) -> Image:
        """Return normal noise of standard deviation 1, with the texture of the point spread.

        The file states the noise of measured images, which the point spread has already smoothed.
        """
        spread, panel = self._spread(), self.panel
        white = rng.standard_normal(panel.shape)
        if spread is None:
            return white
        noise = spread.apply(white.astype(np.float32), panel.pitch_u, panel.pitch_v)
        return noise.astype(np.float64) / spread.noise_gain(panel.pitch_u, panel.pitch_v)

    def _spread(self) -> PointSpreadFunction | None:
        if self.response.mtf is not None:
            frequencies, contrast = read_curve(self.response.mtf)
            return PointSpreadFunction.tabulated(frequencies, contrast, reach_mm=MTF_REACH_MM)
        sigma_mm = self._sigma_mm()
        return PointSpreadFunction.gaussian(sigma_mm) if sigma_mm > 0 else None

    def _sigma_mm(self) -> float:
        """Return the Gaussian's sigma that, with the pixel, has the basic spatial resolution.

        ISO 19232-5 defines that resolution by the wire pair with a dip of 20 % between the wires:
        for thin wires behind a Gaussian, diameter = gap = sqrt(2) sigma.
        """
        pixel = self.panel.pitch_u * self.panel.pitch_v / 12
        return float(np.sqrt(max(self.response.resolution_mm**2 / 2 - pixel, 0.0)))

    def with_bad_pixels(self, image: Image) -> Image:
        """Insert the given grey values at bad pixels."""
        if self.response.bad_pixels is None:
            return image
        wrong = read_image(self.response.bad_pixels, "bad pixels", image.shape)
        return np.where(wrong == -1, image, wrong)

    def stored(self, image: Image) -> NDArray[np.uint16]:
        """Round an image, and clip it to the bit depth."""
        return np.clip(np.rint(image), 0, 2**self.response.bits - 1).astype(np.uint16)


def _extended(values: Image, places: Floats, results: Floats) -> Image:
    """Interpolate linearly, and extrapolate above from the last two values."""
    inside = np.interp(values, places, results)
    if len(places) < 2:
        return inside
    slope = (results[-1] - results[-2]) / (places[-1] - places[-2])
    return np.where(values > places[-1], results[-1] + slope * (values - places[-1]), inside)
