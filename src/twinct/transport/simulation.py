"""Monte Carlo simulation of one view: energy deposited, and images of scatter.

The work is divided into batches. Each has random numbers of its own, keyed by seed, view and batch,
and sums of its own, which are added in the order of the batches: the scores have the same bytes for
any number of threads, and however often the work is interrupted.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.draws import batch_key
from twinct.core.errors import InputError
from twinct.core.interruption import postponed
from twinct.core.progress import SILENT, Progress
from twinct.core.threads import load_numba
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.transport._histories import Field, Pixels, follow, primary, primary_energy
from twinct.transport.beam import Beam
from twinct.transport.cross_sections import TOTAL, TRANSFER, energies_kev
from twinct.transport.grid import NO_GRID, AntiScatterGrid
from twinct.transport.regions import Regions
from twinct.transport.scores import ORDERS, Scores
from twinct.transport.voxel_body import VoxelBody

OVERSAMPLING = 2.0
"""Variance times time falls by up to two from 1 to 2, and is flat up to 16."""

_MOST_OVERSAMPLING = 1000.0
_PURPOSE = "photon transport"

Response = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Signal of a photon of each energy in keV."""


def integrating(energies_kev: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a photon's whole energy, the signal of an ideal energy-integrating detector."""
    return energies_kev


@dataclass(frozen=True, eq=False)
class Detector:
    """The panel of one view.

    Attributes:
        geometry: source and panel of the views.
        view: index of the view.
        response: signal of a photon by its energy.
        grid: anti-scatter grid before the panel, if any.
    """

    geometry: ScanGeometry
    view: int = 0
    response: Response = integrating
    grid: AntiScatterGrid | None = None


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums of the batches that are computed at once."""

    deposits: NDArray[np.float64]
    rows: NDArray[np.float64]
    images: NDArray[np.float64]
    totals: NDArray[np.float64]

    @classmethod
    def of(cls, scores: Scores, batches: int) -> _Sums:
        """Return one row for each thread."""
        import numba

        number = max(min(numba.get_num_threads(), batches), 1)
        shapes = (scores.voxels.shape, scores.rows.shape[1:], scores.images.shape, (4,))
        return cls(*(np.zeros((number, *shape)) for shape in shapes))

    def clear(self) -> None:
        """Set all to 0."""
        for array in (self.deposits, self.rows, self.images, self.totals):
            array[:] = 0.0


class Simulation:
    """Photons of a beam in a body, and what is scored of them."""

    def __init__(
        self,
        body: VoxelBody,
        beam: Beam,
        *,
        dose: bool = True,
        expected: bool = True,
        unscattered: bool = True,
        oversampling: float = OVERSAMPLING,
        regions: Regions | None = None,
        detector: Detector | None = None,
    ) -> None:
        """Prepare the tables for the kernels.

        Args:
            body: the voxels; around them is vacuum.
            beam: source and field.
            dose: score the energy deposited in each voxel; that in each row of the palette, such as
                a label, is always scored.
            expected: tentative collisions along a flight deposit the mean energy that it transfers
                to electrons (collision kerma); False: collisions deposit what they happen to.
                Both have one mean; the first has the smaller variance.
            unscattered: score the energy of photons before their first collision too; False leaves
                it to ``primary_energy``, which has no chance in it. Needs ``expected``.
            oversampling: tentative collisions for each that is needed, at least 1.
            regions: regions in which energy is summed; needs ``dose``.
            detector: panel that gets images of scatter, if any.

        Raises:
            InputError: the regions belong to another grid, or have no dose to sum, the
                oversampling is out of range, or unscattered energy cannot be told apart.
        """
        if not (unscattered or expected):
            raise InputError(
                "unscattered=False needs expected=True: a collision deposits energy of both kinds"
            )
        if not 1 <= oversampling <= _MOST_OVERSAMPLING:
            raise InputError(
                f"oversampling {oversampling:g}: must be from 1 to {_MOST_OVERSAMPLING:g}"
            )
        if regions is not None and not dose:
            raise InputError("regions sum the energy of voxels: they need dose")
        if regions is not None and regions.shape != body.grid.shape:
            raise InputError(
                f"regions of shape {regions.shape}: the body's grid has the shape {body.grid.shape}"
            )
        load_numba()
        self._body, self._beam, self._regions = body, beam, regions
        self._dose, self._ways = dose, (expected, unscattered)
        self._voxels, self._media = body.tables(oversampling if expected else 1.0)
        self._field = _local_field(beam, body.grid)
        self._detector = detector
        self._pixels, self._image_shape = _local_pixels(detector, body.grid)

    def run(
        self,
        photons: int,
        batches: int,
        *,
        seed: int = 0,
        view: int = 0,
        kept: Path | None = None,
        progress: Progress = SILENT,
    ) -> Scores:
        """Follow photons, and return their scores.

        Args:
            photons: photons of a batch.
            batches: number of batches, with those in ``kept``; 20 or more for standard errors.
            seed: seed of all random numbers.
            view: index of the view in these numbers.
            kept: file for the scores of complete batches, written when the work is interrupted and
                at its end. If it exists, the work continues from there.
            progress: receiver of the progress, by batches.

        Raises:
            InputError: a number is too small, or the file belongs to other inputs.
        """
        if photons < 1 or batches < 1:
            raise InputError(f"{batches} batches of {photons} photons: both must be at least 1")
        scores = self._begun(photons, seed, view, kept)
        done = scores.batches
        sums = _Sums.of(scores, batches - done)
        try:
            with progress.stage("photons", batches, done) as step:
                while scores.batches < batches:
                    for _ in range(self._add_batches(scores, sums, batches, seed, view)):
                        step()
        finally:
            if kept is not None and scores.batches > done:
                with postponed():
                    scores.save(kept)
        return scores

    def primary(self, samples: int = 1) -> Floats:
        """Return the image of unscattered photons, signal of one photon, (rows, columns).

        It is a line integral of mu for each line of the spectrum, without chance.

        Args:
            samples: rays along each edge of a pixel.

        Raises:
            InputError: there is no detector.
        """
        if self._detector is None:
            raise InputError("a primary image needs a detector")
        image = np.empty(self._image_shape[1:])
        weights, mu = self._photons_per_sr, self._at_lines(TOTAL)
        primary(self._field, weights, mu, self._voxels, self._pixels, int(samples), image)
        return image

    def primary_energy(self, cells: ArrayLike | None = None) -> Floats:
        """Return the energy that unscattered photons give to electrons, keV per photon.

        It is the collision kerma on a ray through the middle of each voxel, times its mass in the
        field, without chance. With the energy scored after the first collision it is the energy
        deposited.

        Args:
            cells: places of voxels in the flattened grid; all voxels by default.

        Returns:
            As ``cells``, or in the shape of the grid.
        """
        shape = self._body.grid.shape
        places = np.arange(np.prod(shape)) if cells is None else np.asarray(cells, np.int64)
        energies = np.zeros(len(places))
        primary_energy(
            self._field,
            self._photons_per_sr,
            self._at_lines(TOTAL),
            self._at_lines(TRANSFER),
            self._voxels,
            places,
            energies,
        )
        return energies.reshape(shape) if cells is None else energies

    @property
    def _photons_per_sr(self) -> Floats:
        """Share of the photons in each line, per solid angle of the field, (lines,).

        Where the beam has a profile, times its factor.
        """
        beam = self._beam
        return beam.photons / beam.photons.sum() / beam.solid_angle / beam.share

    def _at_lines(self, column: int) -> Floats:
        """Return a coefficient of each medium at the lines of the spectrum, (media, lines)."""
        media = self._media.coefficients[:, :, column].astype(np.float64)
        lines, energies = self._beam.energies_kev, energies_kev()
        return np.array([np.interp(lines, energies, medium) for medium in media])

    def _begun(self, photons: int, seed: int, view: int, kept: Path | None) -> Scores:
        """Return scores of the batches that are kept, or of none."""
        inputs = self._digest(photons, seed, view)
        if kept is not None and kept.exists():
            return Scores.read(kept, inputs)
        names = () if self._regions is None else self._regions.names
        shape = self._body.grid.shape if self._dose else (0, 0, 0)
        voxels, squared = np.zeros(shape), np.zeros(shape)
        images, images_squared = np.zeros(self._image_shape), np.zeros(self._image_shape)
        regions = np.zeros((0, len(names)))
        rows = np.zeros((0, len(self._voxels.media)))
        return Scores(
            photons, inputs, names, voxels, squared, images, images_squared, regions, rows
        )

    def _add_batches(self, scores: Scores, sums: _Sums, batches: int, seed: int, view: int) -> int:
        """Add as many batches as there are threads, and return their number."""
        first = scores.batches
        number = min(len(sums.totals), batches - first)
        numbers = range(first, first + number)
        keys = np.array([batch_key(seed, _PURPOSE, view, n) for n in numbers], np.uint64)
        sums.clear()
        follow(
            keys,
            scores.photons,
            self._field,
            self._voxels,
            self._media,
            self._pixels,
            sums.deposits,
            sums.rows,
            self._ways,
            sums.images,
            sums.totals,
        )
        with postponed():
            for n in range(number):
                energies = sums.deposits[n].ravel()
                shares = np.zeros(0) if self._regions is None else self._regions.shares @ energies
                scores.add(shares, sums.rows[n], sums.deposits[n], sums.images[n], sums.totals[n])
        return number

    def _digest(self, photons: int, seed: int, view: int) -> str:
        """Return the digest of all that the scores depend on."""
        total = hashlib.sha256()
        numbers = (photons, seed, view, self._dose, *self._ways, *self._image_shape, *ORDERS)
        total.update(repr(numbers).encode())
        shares = self._regions
        arrays: list[NDArray[Any]] = []
        for table in (self._voxels, self._media, self._field, self._pixels):
            arrays += [np.asarray(value) for value in table]
        if shares is not None:
            total.update(repr(shares.names).encode())
            arrays += [shares.shares.data, shares.shares.indices, shares.shares.indptr]
        for array in arrays:
            total.update(repr((array.shape, array.dtype.str)).encode())
            total.update(np.ascontiguousarray(array).data)
        return total.hexdigest()


def _local(points: Floats, grid: VolumeGrid) -> Floats:
    """Return points of the world in the frame of the grid's low corner."""
    return grid.world_from_grid.inverse().apply(points) + grid.size_mm / 2


def _turned(vectors: Floats, grid: VolumeGrid) -> Floats:
    """Return directions of the world in the axes of the grid."""
    return vectors @ grid.world_from_grid.rotation


def _local_field(beam: Beam, grid: VolumeGrid) -> Field:
    u, v = _turned(beam.u, grid), _turned(beam.v, grid)
    source, centre = _local(beam.source, grid), _local(beam.centre, grid)
    inside = np.array(np.linalg.inv(np.array([u, v, centre - source]).T), np.float64)
    energies = np.array(beam.energies_kev)
    lines, profile = (energies, beam.cumulative), np.array(beam.profile)
    most = float(profile.max(initial=0.0))
    return Field(source, centre, u, v, inside, beam.shortest, *lines, profile, most)


def _local_pixels(
    detector: Detector | None, grid: VolumeGrid
) -> tuple[Pixels, tuple[int, int, int]]:
    """Return the panel for the kernels, and the shape of its images."""
    if detector is None:
        none = np.zeros(3)
        panel = none, none.copy(), none.copy(), np.ones(2), np.zeros(2)
        return Pixels(*panel, NO_GRID.copy(), np.zeros((2, 2))), (0, 0, 0)
    geometry, view = detector.geometry, detector.view
    if not 0 <= view < len(geometry.source):
        raise InputError(f"view {view}: the geometry has the views 0 to {len(geometry.source) - 1}")
    panel = geometry.panel
    width, height = panel.size_mm
    u, v = geometry.u[view], geometry.v[view]
    corner = geometry.detector[view] - width / 2 * u - height / 2 * v
    response = np.array(detector.response(energies_kev()), np.float64)
    if response.shape != energies_kev().shape or not np.isfinite(response).all():
        raise InputError("response: must be a finite number for each energy in keV")
    grid_shape, barriers = NO_GRID.copy(), np.zeros((2, len(response)))
    if detector.grid is not None:
        grid_shape = detector.grid.shape
        barriers = detector.grid.attenuation(energies_kev())
    pixels = Pixels(
        _local(corner, grid),
        _turned(u, grid),
        _turned(v, grid),
        np.array([panel.pitch_u, panel.pitch_v]),
        response,
        grid_shape,
        barriers,
    )
    return pixels, (len(ORDERS), panel.rows, panel.columns)
