"""Scattered radiation by Monte Carlo: a few views and coarse pixels, interpolated to all.

Scatter is smooth over the panel, and changes slowly with source and panel. So it is simulated for
nodes, views of the path that lie far from each other, on coarse pixels (``ViewNodes``).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.specimen import BuiltSpecimen
from twinct.transport import AntiScatterGrid, Detector, Simulation, VoxelBody
from twinct.transport.cross_sections import require_energies
from twinct.xray.beam_shape import BeamShape
from twinct.xray.response import PhotonResponse
from twinct.xray.sections import MonteCarloScatter
from twinct.xray.spectrum import PhotonSpectrum
from twinct.xray.view_nodes import ViewNodes
from twinct.xray.voxel_specimen import grid_of, in_voxels

LEAST_WEIGHT = 1e-6
"""Weight of a node below which its image does not count; at another node, rounding gives 1e-15."""

BATCHES = 16
"""A batch is the least share of the work of a thread."""


class ScatterSettings(Protocol):
    """Keys of the simulated views: see ``MonteCarloScatter``."""

    @property
    def photons(self) -> int:
        """Photons of each simulated view."""
        ...

    @property
    def views(self) -> int:
        """Views that are simulated."""
        ...

    @property
    def pixel_mm(self) -> float:
        """Edge of the coarse pixels."""
        ...


_VOXELS = "detector.scatter.voxel_mm"
_MM2_PER_SR_AT_1_M = 1e6


class ScatterNodes:
    """Scatter of a body on one panel, from simulated views.

    The body is at rest, and alone: objects of the room and air do not scatter. The beam covers just
    the panel.
    """

    def __init__(
        self,
        body: VoxelBody,
        views: ScanGeometry,
        beam: BeamShape,
        response: PhotonResponse,
        grid: AntiScatterGrid | None,
        settings: ScatterSettings,
        seed: int = 0,
    ) -> None:
        """Choose the nodes; each is simulated when a view needs it.

        Args:
            body: the body.
            views: views from which the nodes are chosen, in the body's frame.
            beam: the free beam.
            response: signal of a photon.
            grid: the grid before the panel, if any.
            settings: number of nodes, their photons, and size of the coarse pixels.
            seed: seed of the random numbers.

        Raises:
            InputError: a photon energy is outside the tables.
        """
        self._body, self._settings, self._seed = body, settings, seed
        self._beam, self._response, self._grid = beam, response, grid
        self._panel = views.panel
        width, height = views.panel.size_mm
        columns, rows = (max(round(n / settings.pixel_mm), 1) for n in (width, height))
        self._coarse = Panel(rows, columns, width / columns, height / rows)
        self._views = ScanGeometry(views.source, views.detector, views.u, views.v, self._coarse)
        self._nodes = ViewNodes(self._views, settings.views)
        self._images: dict[int, Floats] = {}
        require_energies(beam.spectrum.energies_kev)

    def image(self, view: ScanGeometry) -> NDArray[np.float32]:
        """Return the scatter in one view, (rows, columns).

        Args:
            view: exactly one view, in the frame of the body.

        Returns:
            Expected signal per mm^2 of the panel, for the photons of the spectrum.
        """
        coarse = np.zeros(self._coarse.shape)
        (weights,) = self._nodes.weights(view).tolist()
        for node, weight in zip(self._nodes.chosen.tolist(), weights, strict=True):
            if abs(weight) > LEAST_WEIGHT:
                coarse += weight * self._simulated(node)
        panel, cells = self._panel, self._coarse
        rows, columns = (
            (np.arange(fine) + 0.5) * few / fine - 0.5
            for fine, few in zip(panel.shape, cells.shape, strict=True)
        )
        at = np.meshgrid(rows, columns, indexing="ij")
        fine = scipy.ndimage.map_coordinates(coarse, at, order=1, mode="nearest")
        return fine.astype(np.float32)

    def _simulated(self, node: int) -> Floats:
        """Return the scatter of a node on the coarse pixels, as ``image`` does."""
        if node not in self._images:
            beam = self._beam.beam(self._views, node)
            simulation = Simulation(
                self._body,
                beam,
                dose=False,
                detector=Detector(self._views, node, self._response.mean, self._grid),
            )
            photons = -(-self._settings.photons // BATCHES)
            scores = simulation.run(photons, BATCHES, seed=self._seed, view=node)
            scatter, _ = scores.scatter()
            per_sr = self._beam.spectrum.total * _MM2_PER_SR_AT_1_M
            in_field = per_sr * beam.solid_angle * beam.share
            area = self._coarse.pitch_u * self._coarse.pitch_v
            self._images[node] = scatter.sum(axis=0) * (in_field / area)
        return self._images[node]


def scatter_of(
    settings: MonteCarloScatter,
    specimen: BuiltSpecimen,
    beam: BeamShape,
    response: PhotonResponse,
    grid: AntiScatterGrid | None,
    panel: Panel,
    commanded: ScanGeometry,
) -> ScatterNodes:
    """Return the scatter of a specimen in its reference state.

    Args:
        settings: ``detector.scatter``.
        specimen: the specimen.
        beam: the free beam.
        response: signal of a photon.
        grid: the grid before the panel, if any.
        panel: physical pixels.
        commanded: commanded views, in the world.

    Raises:
        InputError: a photon energy is outside the tables, or there are too many voxels.
    """
    body = body_of(settings, specimen)
    views = replace(specimen.world_from_specimen.inverse() @ commanded, panel=panel)
    return ScatterNodes(body, views, beam, response, grid, settings)


def body_of(settings: MonteCarloScatter, specimen: BuiltSpecimen) -> VoxelBody:
    """Return the voxels that stand for a specimen.

    Raises:
        InputError: there are too many voxels.
    """
    return in_voxels(specimen, grid_of(specimen, settings.voxel_mm, _VOXELS))


def check_scatter(
    settings: MonteCarloScatter, specimen: BuiltSpecimen, spectrum: PhotonSpectrum
) -> None:
    """Check that scatter can be simulated, before any work.

    Raises:
        InputError: a photon energy is outside the tables, or there are too many voxels.
    """
    require_energies(spectrum.energies_kev, "source")
    grid_of(specimen, settings.voxel_mm, _VOXELS)
