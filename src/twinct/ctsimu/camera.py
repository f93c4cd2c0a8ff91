"""Energy collected by each pixel in one frame, without noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from trimesh import Trimesh

from twinct.core.errors import InputError
from twinct.core.files.tables import read_curve
from twinct.ctsimu import scene
from twinct.ctsimu.sampling import Sampling, sampling
from twinct.ctsimu.scene import Frame, Layer, Tube
from twinct.ctsimu.solids import Solids
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.specimen import BuiltPart, Material
from twinct.xray.beam import fall_off
from twinct.xray.paths import PathRenderer
from twinct.xray.response import PhotonResponse
from twinct.xray.signal import Signal
from twinct.xray.spectrum import PhotonSpectrum
from twinct.xray.tube import tube_spectrum

J_PER_KEV = 1.602176634e-16
MM2_AT_1M_PER_SR = 1e6
TAKE_OFF_DEG = 45.0
"""Default for targets without a stated angle."""


class Camera:
    """Camera for the frames of one scenario; gVXR stays open until the camera is closed.

    Args:
        samples: rays along each pixel edge, for a point source.
        spot_points: passes over the panel for an extended focal spot.
    """

    def __init__(self, samples: int = 3, spot_points: int = 32) -> None:
        self._samples, self._spot_points = samples, spot_points
        self._solids = Solids()
        self._renderer: PathRenderer | None = None
        self._uploaded: object = None
        self._plan: tuple[scene.FocalSpot, Sampling] | None = None
        self._signal: tuple[object, Signal, bool] | None = None

    def expose(self, frame: Frame, *, samples_in: bool = True) -> NDArray[np.float64]:
        """Return the energy that each pixel collects, J, (rows, columns) in our order of rows.

        The photon number of a monochromatic source is unknown, so its energies are relative.
        Without ``samples_in``, the beam is free.

        Raises:
            InputError: a file does not hold the data that the scenario states; names it.
            TwinctError: a sample reaches through the panel or around the source.
        """
        sampling = self._sampling(frame)
        solids = self._solids.of(frame.samples, frame.view.source[0]) if samples_in else []
        materials, renderer = self._open(frame.panel, sampling.samples, solids)
        room = [frame.environment] if frame.environment is not None else []
        signal, absolute = self._response(frame, (*materials, *room))
        poses = [sample.world_from_sample for sample, _ in solids]
        image = np.zeros((2, *frame.panel.shape), dtype=np.float32)
        for start, shift in zip(sampling.spot_mm, sampling.shift, strict=True):
            view = _shifted(frame, start, shift)
            beam = fall_off(view, sampling.samples)
            paths = np.zeros((0, *beam.shape), dtype=np.float32)
            if renderer is not None:
                paths = renderer.render(view, poses)
            if room:
                rest = _ray_lengths(view, sampling.samples) - paths.sum(axis=0)
                paths = np.concatenate([paths, np.maximum(rest, 0.0)[None]])
            signal.add(paths, beam, image, samples=sampling.samples, share=1 / len(sampling.shift))
        area = frame.panel.pitch_u * frame.panel.pitch_v
        charge_mas = frame.tube.current_ma * frame.exposure_s if absolute else 1.0
        return image[0].astype(np.float64) * (area * charge_mas * J_PER_KEV)

    def close(self) -> None:
        """Release gVXR."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer, self._uploaded = None, None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _sampling(self, frame: Frame) -> Sampling:
        spot, pixels = frame.spot, max(frame.panel.shape)
        if self._plan is None or self._plan[0] != spot:
            self._plan = spot, sampling(spot, self._samples, self._spot_points, pixels)
        return self._plan[1]

    def _open(
        self, panel: Panel, samples: int, solids: Sequence[tuple[scene.Sample, Trimesh]]
    ) -> tuple[tuple[Material, ...], PathRenderer | None]:
        if not solids:
            return (), None
        bodies = [
            BuiltPart(b.material.name, b.material, mesh)
            for b, mesh in solids
            if b.material is not None
        ]
        key = panel, samples, [(id(body.mesh), body.material) for body in bodies]
        if key != self._uploaded or self._renderer is None:
            self.close()
            self._renderer, self._uploaded = PathRenderer(bodies, panel, samples), key
        return self._renderer.materials, self._renderer

    def _response(self, frame: Frame, media: tuple[Material, ...]) -> tuple[Signal, bool]:
        key = frame.tube, frame.response, media
        if self._signal is None or self._signal[0] != key:
            spectrum = _spectrum(frame.tube)
            signal = Signal(spectrum, media, _photon_response(frame.response))
            self._signal = key, signal, spectrum.absolute
        return self._signal[1:]


def _spectrum(tube: Tube) -> PhotonSpectrum:
    """Return the spectrum behind all filters, in photons per mm^2 at 1 m and mAs if known."""
    if tube.monochromatic:
        spectrum = PhotonSpectrum.monochromatic(tube.voltage_kv)
    elif tube.spectrum is not None:
        energies, photons = read_curve(tube.spectrum)
        keep = energies > 0
        try:
            spectrum = PhotonSpectrum(energies[keep], photons[keep] / MM2_AT_1M_PER_SR)
        except InputError as error:
            raise InputError([f"{tube.spectrum}: {p}" for p in error.problems]) from None
    else:
        angle = TAKE_OFF_DEG if tube.take_off_deg is None else tube.take_off_deg
        spectrum = _behind(tube_spectrum(tube.voltage_kv, angle), tube.window)
    return _behind(spectrum, tube.filters)


def _photon_response(detector: scene.PanelResponse) -> PhotonResponse:
    """Return the energy collected per photon, as a function of the photon energy."""
    response = PhotonResponse.integrating()
    if detector.real and detector.efficiency is not None:
        response = PhotonResponse.efficiency(*read_curve(detector.efficiency))
    elif detector.real and detector.scintillator is not None:
        layer = detector.scintillator
        response = PhotonResponse.scintillator(layer.material, layer.thickness_mm)
    for layer in detector.front:
        response = response.behind(layer.material, layer.thickness_mm)
    return response


def _behind(spectrum: PhotonSpectrum, layers: tuple[Layer, ...]) -> PhotonSpectrum:
    for layer in layers:
        spectrum = spectrum.filtered(layer.material, layer.thickness_mm)
    return spectrum


def _shifted(frame: Frame, start: Floats, shift: Floats) -> ScanGeometry:
    """Return the view from one point of the focal spot to one position in the pixels."""
    view, panel = frame.view, frame.panel
    source = view.source + start @ frame.source_axes
    middle = view.detector + shift[0] * panel.pitch_u * view.u + shift[1] * panel.pitch_v * view.v
    return replace(view, source=source, detector=middle)


def _ray_lengths(view: ScanGeometry, samples: int) -> NDArray[np.float32]:
    """Return the distances from the source to each sample, mm."""
    places = replace(view, panel=view.panel.divided(samples)).pixel_centres(0)
    return np.linalg.norm(places - view.source[0], axis=-1).astype(np.float32)
