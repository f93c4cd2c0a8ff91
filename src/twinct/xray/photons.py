"""Photons of the free beam, as far as a scenario states its noise."""

from __future__ import annotations

from dataclasses import dataclass

from twinct.geometry import ScanGeometry
from twinct.xray import sections
from twinct.xray.build import build_spread
from twinct.xray.chain import ImagingChain


@dataclass(frozen=True)
class FreePhotons:
    """Photons of a pixel in the free beam, at ``source.mas``, in the middle of the first view.

    Both count what the noise is equal to: photons of different signals make more of it than as many
    equal ones.

    Attributes:
        number: from the noise of many pixels together.
        single: from the noise of a single pixel, larger where the point spread blurs it.
    """

    number: float
    single: float

    @classmethod
    def of_snr(cls, noise: sections.SnrNoise) -> FreePhotons:
        """Return the photons of a stated signal-to-noise ratio of a pixel."""
        return cls((noise.snr * noise.gain) ** 2, noise.snr**2)


def free_photons(
    source: sections.Source, detector: sections.Detector, commanded: ScanGeometry
) -> FreePhotons | None:
    """Return the photons behind a scenario's noise; None if it states none."""
    noise = detector.noise
    if noise is None:
        return None
    if isinstance(noise, sections.SnrNoise):
        return FreePhotons.of_snr(noise)
    signal, square = ImagingChain(source, detector, (), commanded[:1]).free
    number = float(signal**2 / square) * detector.binning**2
    spread, panel = build_spread(detector), detector.panel
    gain = 1.0 if spread is None else spread.noise_gain(panel.pitch_u, panel.pitch_v)
    return FreePhotons(number, number / gain**2)
