"""The detection chain: from the expected signal of each pixel to grey values and transmission."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.core.draws import view_rng
from twinct.geometry import MM_PER_M, Floats, ScanGeometry
from twinct.specimen.materials import Material
from twinct.xray import sections
from twinct.xray.beam import fall_off
from twinct.xray.build import (
    build_bad_pixels,
    build_beam,
    build_grid,
    build_response,
    build_spot,
    build_spread,
    physical_panel,
)
from twinct.xray.noise import normal_noise, quantum_noise
from twinct.xray.readout import Amplifier, binned, correct, mend_bad_pixels
from twinct.xray.shading import shading_of
from twinct.xray.signal import Signal
from twinct.xray.spot import moved_source

Image = NDArray[np.float32]

_LEAST_TRANSMISSION = 1e-7
"""Smallest transmission of an image without noise and bit depth."""


@dataclass(frozen=True, eq=False)
class ViewImages:
    """Images of one view, (rows, columns) each.

    ``raw``, ``flat`` (the free beam) and ``dark`` are grey values; bad pixels are 0 in ``raw``.
    ``transmission`` is computed from them, positive, with bad pixels filled.
    """

    raw: Image
    flat: Image
    dark: Image
    transmission: Image


class ImagingChain:
    """Source and detector of one scenario.

    The steps follow the physics: the expected signal of each physical pixel (the mean over the
    exposure's renders), scatter, the quantum noise of the absorbed photons, the point spread of the
    detector (which blurs that noise too), lag (which carries both on), electronic noise, binning,
    gain, offset, saturation and bit depth, bad pixels. Flat and dark images go through the same
    steps.

    Attributes:
        panel: physical pixels, before binning.
        spot: points of the focal spot in the source frame's x and y, (points, 2), mm.
        samples: samples along each edge of a physical pixel.
        beam: the free beam.
        grid: the anti-scatter grid, if any.
        free: expected signal of a physical pixel and its variance, in the free beam at the middle
            of the first commanded view's panel, at ``source.mas``, (2,).
    """

    def __init__(
        self,
        source: sections.Source,
        detector: sections.Detector,
        materials: Sequence[Material],
        commanded: ScanGeometry,
        seed: int = 0,
        mas: Floats | None = None,
    ) -> None:
        """Build the models of source and detector.

        Args:
            source: source section of the scenario.
            detector: detector section of the scenario.
            materials: materials of the path lengths, in their order.
            commanded: commanded views. The first sets the gain, and is the view of flat images that
                are taken once.
            seed: key of every random draw.
            mas: tube load of each commanded view, (views,), mAs; ``source.mas`` by default.
        """
        self._loads = None if mas is None else np.asarray(mas, dtype=np.float64) / source.mas
        self.beam, self.grid = build_beam(source), build_grid(detector)
        spectrum = self.beam.spectrum
        self.spot = build_spot(source)
        self.panel = physical_panel(detector)
        self.samples = detector.pixel_samples
        self._detector, self._seed = detector, seed
        self._response = build_response(detector)
        self._signal = Signal(spectrum, materials, self._response)
        unit = source.mas if spectrum.absolute else 1.0
        self._scale = np.float32(unit * self.panel.pitch_u * self.panel.pitch_v)
        self._commanded = self.physical(commanded)
        at_middle = np.mean([_at_middle(seen) for seen in self.from_spot(commanded[0])])
        self.free: Floats = self._signal.free * float(self._scale) * float(at_middle)
        self._spread = build_spread(detector)
        self._bad = build_bad_pixels(detector, seed)
        self._amplifier, self._electronic = Amplifier(1 / float(self.free[0])), 0.0
        if (readout := detector.readout) is not None:
            # One gain for the whole scan: no view's free beam exceeds ``free_beam``.
            brightest = 1.0 if self._loads is None else float(self._loads.max())
            gain = readout.free_beam / (float(self.free[0]) * brightest)
            self._amplifier = Amplifier(gain, readout.offset, readout.bits, readout.saturation)
            # For a physical pixel, in grey values.
            self._electronic = readout.electronic_noise * detector.binning

    def load(self, index: int) -> float:
        """Return a view's mAs in units of ``source.mas``; 1 for views without a commanded load."""
        if self._loads is None or not 0 <= index < len(self._loads):
            return 1.0
        return float(self._loads[index])

    def physical(self, view: ScanGeometry) -> ScanGeometry:
        """Return a view with the physical pixels."""
        return ScanGeometry(view.source, view.detector, view.u, view.v, self.panel)

    def from_spot(self, view: ScanGeometry) -> Iterator[ScanGeometry]:
        """Yield the view from each point of the focal spot."""
        for offset in self.spot:
            yield moved_source(view, offset) if offset.any() else view

    def blank(self) -> Image:
        """Return an empty accumulator: mean and mean square of the signal, (2, rows, columns)."""
        return np.zeros((2, *self.panel.shape), dtype=np.float32)

    def add(self, paths: Image, view: ScanGeometry, out: Image, share: float = 1.0) -> None:
        """Add one render to an exposure, an ``out`` from ``blank``.

        Args:
            paths: path lengths at the samples, (materials, ...), mm.
            view: executed view on the physical pixels.
            out: accumulator of the exposure.
            share: weight among the renders of this exposure.
        """
        beam, share = fall_off(view, self.samples), share * float(self._scale)
        shading = shading_of(self.beam, self.grid, view, self.samples)
        self._signal.add(paths, beam, out, samples=self.samples, share=share, shading=shading)

    def add_scatter(self, per_mm2: Image, out: Image, share: float = 1.0) -> None:
        """Add scatter to an exposure, as the photons of the free beam on average.

        Args:
            per_mm2: expected signal per mm^2 for the photons of the spectrum, (rows, columns).
            out: accumulator of the exposure.
            share: weight, as in ``add``.
        """
        scatter = per_mm2 * (self._scale * np.float32(share))
        out[0] += scatter
        out[1] += np.float32(self.free[1] / self.free[0]) * scatter

    def frame(
        self,
        expected: Image,
        view: ScanGeometry,
        index: int,
        before: Image | None = None,
        repetition: int = 0,
    ) -> ViewImages:
        """Return the detector's images of one view.

        Args:
            expected: accumulated exposure from ``add``.
            view: executed view on the physical pixels.
            index: index of the view; keys the noise.
            before: ``expected`` of the previous view, whose signal lags.
            repetition: number of the scan; each has noise of its own, with the same flat and dark
                images.
        """
        rng = self._rng(index, repetition)
        signal = self._signal_of(expected, rng)
        if before is not None:
            # The previous noise is drawn again by its own key.
            last = self._signal_of(before, self._rng(index - 1, repetition))
            signal = self._lagging(signal, last)
        if self._electronic:
            signal = normal_noise(signal, self._electronic / self._amplifier.gain, rng)
        raw = self._amplifier.read(binned(signal, self._detector.binning))
        flat, dark = self._flat(view, index), self._dark
        transmission = correct(raw, flat, dark, self._floor())
        raw = np.where(self._bad, np.float32(0), raw) if self._bad.any() else raw
        return ViewImages(raw, flat, dark, mend_bad_pixels(transmission, self._bad))

    def mean(self, expected: Image, before: Image | None = None) -> Image:
        """Return the signal of one view without noise, (rows, columns), as in ``frame``."""
        signal = self._signal_of(expected, None)
        if before is not None:
            signal = self._lagging(signal, self._signal_of(before, None))
        return binned(signal, self._detector.binning)

    def _lagging(self, signal: Image, last: Image) -> Image:
        lag = np.float32(self._detector.lag)
        return ((1 - lag) * signal + lag * last).astype(np.float32, copy=False)

    def _rng(self, index: int, repetition: int) -> np.random.Generator:
        purpose = f"detector noise, repetition {repetition}" if repetition else "detector noise"
        # Modulo: a view imaged alone, as view 0, may still have a predecessor.
        return view_rng(self._seed, purpose, index % 2**64)

    def _signal_of(self, expected: Image, rng: np.random.Generator | None) -> Image:
        """Return one exposure's signal in the physical pixels, with noise and spread.

        None for the generator: without noise.
        """
        detector, pitch = self._detector, (self.panel.pitch_u, self.panel.pitch_v)
        signal = expected[0]
        if rng is not None and isinstance(detector.noise, sections.QuantumNoise):
            signal = quantum_noise(signal, expected[1], rng)
        if self._spread is not None:
            signal = self._spread.apply(signal, *pitch)
        if rng is not None and isinstance(detector.noise, sections.SnrNoise):
            free = np.float32(self.free[0])
            sigma = np.sqrt(np.maximum(signal, np.float32(0)) * free)
            sigma *= np.float32(detector.binning / detector.noise.snr)
            signal = normal_noise(signal, sigma, rng)
        return signal

    def _flat(self, view: ScanGeometry, index: int) -> Image:
        """Return the flat image with normal noise for its photon number, one pattern per scan."""
        way, commanded = self._detector.correction.flat_geometry, self._commanded
        if way == "view":
            return self._flat_at(self._lit(view) * np.float32(self.load(index)))
        # The flat is taken at the first view's mAs; the generator reports every view's mAs.
        more = np.float32(self.load(index) / self.load(0))
        if index == 0 or (way == "first" and more == 1):
            return self._first_flat
        scale: Image | np.float32 = more
        if way != "first":
            here = commanded[index] if index < len(commanded) else view
            # Distance and tilt: no machine knows what the grid cuts off elsewhere.
            beams = self._free_beam(here) / self._first_beam
            scale = binned(beams, self._detector.binning) * more
        lit = self._first_flat - self._dark
        return (self._dark + lit * scale).astype(np.float32, copy=False)

    @cached_property
    def _first_beam(self) -> Image:
        return self._free_beam(self._commanded[0])

    @cached_property
    def _first_flat(self) -> Image:
        return self._flat_at(self._lit(self._commanded[0]) * np.float32(self.load(0)))

    def _lit(self, view: ScanGeometry) -> Image:
        """Return mean and mean square of the signal in the free beam, (2, rows, columns)."""
        if self.beam.uniform and self.grid is None:
            free = self._signal.free.astype(np.float32) * self._scale
            return free[:, None, None] * self._free_beam(view)
        of = self.beam, self.grid, self._response
        lit = [Signal.lit(*of, seen, self.samples) for seen in self.from_spot(view)]
        return np.asarray(np.mean(lit, axis=0) * self._scale, np.float32)

    def _free_beam(self, view: ScanGeometry) -> Image:
        """Return the fall-off at each physical pixel."""
        # From every point of the spot, like the views, so that the effect of an off-centre spot
        # cancels.
        first, *others = self.from_spot(view)
        beam = binned(fall_off(first, self.samples), self.samples)
        for seen in others:
            beam += binned(fall_off(seen, self.samples), self.samples)
        if others:
            beam /= np.float32(len(self.spot))
        return beam

    def _flat_at(self, lit: Image) -> Image:
        detector, frames = self._detector, self._detector.correction.flat_frames
        signal = lit[0]
        if self._spread is not None:
            signal = self._spread.apply(signal, self.panel.pitch_u, self.panel.pitch_v)
        if frames:
            variance = np.zeros_like(signal)
            if isinstance(detector.noise, sections.QuantumNoise):
                variance = lit[1]
            elif isinstance(detector.noise, sections.SnrNoise):
                share = detector.binning / detector.noise.snr
                variance = signal * np.float32(self.free[0] * share**2)
            # Lag carries noise from frame to frame, so an average of few frames has less noise.
            lag = detector.lag
            variance = variance * np.float32(1 - 2 * lag * (1 - lag) / frames)
            variance = variance + np.float32((self._electronic / self._amplifier.gain) ** 2)
            signal = signal + np.sqrt(variance / np.float32(frames)) * self._flat_pattern
        return self._average(signal, frames)

    @cached_property
    def _flat_pattern(self) -> Image:
        """Unit noise of the flat image; the point spread blurs quantum noise."""
        pattern = self._pattern("flat noise")
        if isinstance(self._detector.noise, sections.QuantumNoise) and self._spread is not None:
            pattern = self._spread.apply(pattern, self.panel.pitch_u, self.panel.pitch_v)
        return pattern

    @cached_property
    def _dark(self) -> Image:
        signal = np.zeros(self.panel.shape, dtype=np.float32)
        frames = self._detector.correction.dark_frames
        if frames and self._electronic:
            sigma = self._electronic / self._amplifier.gain / np.sqrt(frames)
            signal = np.float32(sigma) * self._pattern("dark noise")
        return self._average(signal, frames)

    def _pattern(self, purpose: str) -> Image:
        """Return unit normal noise of the physical pixels."""
        rng = view_rng(self._seed, purpose, 0)
        return rng.standard_normal(self.panel.shape, dtype=np.float32)

    def _average(self, signal: Image, frames: int) -> Image:
        """Return grey values of an average of frames: fractions, except for a single frame."""
        readout = self._amplifier
        if frames != 1:
            readout = Amplifier(readout.gain, readout.offset, None, min(readout.largest, 3e38))
        return readout.read(binned(signal, self._detector.binning))

    def _floor(self) -> float:
        """Return the smallest grey value above the dark image that counts as light."""
        if self._detector.readout is not None:
            return 0.5
        if isinstance(self._detector.noise, sections.QuantumNoise):
            photon = self.free[1] / self.free[0] / self._detector.binning**2
            return 0.5 * float(photon) * self._amplifier.gain
        return _LEAST_TRANSMISSION


def _at_middle(view: ScanGeometry) -> float:
    """Return ``fall_off`` at the middle of the panel."""
    to_source = view.source[0] - view.detector[0]
    distance = float(np.linalg.norm(to_source))
    return MM_PER_M**2 * float(to_source @ view.normal[0]) / distance**3
