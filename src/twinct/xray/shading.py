"""Factors on the photons of each energy by place on the panel, for the sum over a spectrum.

Heel effect and bowtie come from the beam, cut-off from the grid. All of them are 1 on a central ray
that is parallel to the strips of the grid: spectrum and response hold what is common to all rays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry
from twinct.xray.beam_shape import BeamShape, nodes_of

if TYPE_CHECKING:  # its kernels take a second to load
    from twinct.transport import AntiScatterGrid


class Shading(NamedTuple):
    """Factors on a lattice of nodes, and the place of each sample among them.

    Attributes:
        table: factor of each bin at each node, (bins, nodes along v, nodes along u).
        rows: place of each row of samples, in nodes.
        columns: place of each column of samples.
    """

    table: NDArray[np.float32]
    rows: NDArray[np.float32]
    columns: NDArray[np.float32]


UNSHADED = Shading(np.zeros((0, 1, 1), np.float32), *(np.zeros(0, np.float32) for _ in range(2)))


def shading_of(
    shape: BeamShape, grid: AntiScatterGrid | None, view: ScanGeometry, samples: int
) -> Shading:
    """Return the factors of a view.

    Args:
        shape: the beam.
        grid: the grid before the panel, if any.
        view: exactly one view, on the physical pixels.
        samples: samples along each pixel edge.
    """
    if shape.uniform and grid is None:
        return UNSHADED
    u, v = nodes_of(view)
    table = shape.factors(view, u, v)
    if grid is not None:
        table *= grid_factors(grid, shape.spectrum.energies_kev, view, u, v)
    places = (
        ((np.arange(n * samples) + 0.5) / (n * samples) * (len(nodes) - 1)).astype(np.float32)
        for n, nodes in zip(view.panel.shape, (v, u), strict=True)
    )
    return Shading(table.astype(np.float32), *places)


def grid_factors(
    grid: AntiScatterGrid, energies_kev: Floats, view: ScanGeometry, u_mm: Floats, v_mm: Floats
) -> Floats:
    """Return the transmission of the primary beam, relative to a normal ray between the strips.

    Returns:
        (energies, v, u).
    """
    to_source = view.source[0] - view.detector[0]
    distance = to_source @ view.normal[0]
    along_u = np.broadcast_to((u_mm - to_source @ view.u[0]) / distance, (len(v_mm), len(u_mm)))
    along_v = ((v_mm - to_source @ view.v[0]) / distance)[:, None]
    if grid.along == "v":
        passed = grid.transmission(energies_kev, along_u, along_v, u_mm)
    else:
        passed = grid.transmission(energies_kev, along_v, along_u, v_mm[:, None])
    return passed / grid.transmission(energies_kev, 0.0, 0.0)[:, None, None]
