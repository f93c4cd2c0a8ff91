"""From path lengths to the expected signal of each pixel, over a whole spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry
from twinct.specimen.materials import Material
from twinct.xray.beam import fall_off
from twinct.xray.beam_shape import BeamShape
from twinct.xray.response import PhotonResponse
from twinct.xray.shading import UNSHADED, Shading, shading_of
from twinct.xray.spectrum import PhotonSpectrum, attenuation

if TYPE_CHECKING:  # its kernels take a second to load
    from twinct.transport import AntiScatterGrid

NODES = 16384
"""Nodes of the table for one material; interpolation errs by 2e-6 of a signal at its darkest."""

_DARK = 1e-12
"""Remaining share of the signal at the end of the table."""
_LONGEST_MM = 1e5


class Signal:
    """Beer-Lambert law over a spectrum, for one detector.

    The signal of each pixel is the sum over bins of photons x response x exp(-sum over materials of
    mu L), times the fall-off of the beam, averaged over the samples inside the pixel. The mean
    square of the response is treated likewise, for the noise.

    Attributes:
        free: mean and mean square per mm^2 at 1 m and mAs in the free beam, (2,).
    """

    def __init__(
        self, spectrum: PhotonSpectrum, materials: Sequence[Material], response: PhotonResponse
    ) -> None:
        """Compute the attenuations."""
        energies = spectrum.energies_kev
        mean = spectrum.photons * response.mean(energies)
        square = spectrum.photons * response.square(energies)
        mus = np.zeros((len(energies), len(materials)))
        for m, material in enumerate(materials):
            mus[:, m] = attenuation(material, energies)
        self.free: Floats = np.array([mean.sum(), square.sum()])
        self._mean, self._square = mean.astype(np.float32), square.astype(np.float32)
        self._mus = mus.astype(np.float32)
        self._longest, self._table = 0.0, np.zeros((2, 0), dtype=np.float32)
        if len(materials) == 1:
            self._longest, self._table = _tabulate(mus[:, 0], mean, square)

    def add(
        self,
        paths: NDArray[np.float32],
        beam: NDArray[np.float32],
        out: NDArray[np.float32],
        *,
        samples: int = 1,
        share: float = 1.0,
        shading: Shading = UNSHADED,
    ) -> None:
        """Add one exposure to an image.

        Args:
            paths: path lengths, (materials, rows * samples, columns * samples), mm; below 0 where a
                reconstructed volume is.
            beam: ``fall_off`` at each sample, (rows * samples, columns * samples).
            out: mean and mean square of the signal, (2, rows, columns), per mm^2 of panel and mAs.
            samples: samples along each pixel edge.
            share: weight of this exposure in the image.
            shading: factors on the bins by place.
        """
        from twinct.xray._attenuated import look_up, sum_bins

        shaded = shading is not UNSHADED
        if len(paths) == 1 and paths.min() >= 0 and not shaded:  # the table begins at 0
            look_up(paths[0], self._longest, self._table, beam, samples, share, out)
        else:
            bins = self._mus, self._mean, self._square
            sum_bins(paths, *bins, beam, samples, np.float32(share), tuple(shading), out)

    @classmethod
    def lit(
        cls,
        beam: BeamShape,
        grid: AntiScatterGrid | None,
        response: PhotonResponse,
        view: ScanGeometry,
        samples: int = 1,
    ) -> NDArray[np.float32]:
        """Return mean and mean square of the signal in the free beam, (2, rows, columns).

        Per mm^2 of the panel and mAs; ``response`` is that behind the grid.
        """
        out = np.zeros((2, *view.panel.shape), np.float32)
        paths = np.zeros((0, *(n * samples for n in view.panel.shape)), np.float32)
        shading = shading_of(beam, grid, view, samples)
        free = cls(beam.spectrum, (), response)
        free.add(paths, fall_off(view, samples), out, samples=samples, shading=shading)
        return out

    def __call__(
        self, paths: NDArray[np.float32], beam: NDArray[np.float32], samples: int = 1
    ) -> NDArray[np.float32]:
        """Return mean and mean square of one exposure, (2, rows, columns); see ``add``."""
        rows, columns = paths.shape[1] // samples, paths.shape[2] // samples
        out = np.zeros((2, rows, columns), dtype=np.float32)
        self.add(paths, beam, out, samples=samples)
        return out


def _tabulate(mu: Floats, mean: Floats, square: Floats) -> tuple[float, NDArray[np.float32]]:
    """Return the last node's path length and the table, dense where soft photons are absorbed."""
    low, high = 0.0, _LONGEST_MM
    for _ in range(60):
        middle = (low + high) / 2
        seen = mean @ np.exp(-middle * mu) > _DARK * mean.sum()
        low, high = (middle, high) if seen else (low, middle)
    passed = np.exp(-np.multiply.outer(high * np.linspace(0, 1, NODES + 1) ** 2, mu))
    return high, np.stack([passed @ mean, passed @ square]).astype(np.float32)
