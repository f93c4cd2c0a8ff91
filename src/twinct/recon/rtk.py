"""RTK's SART on the CPU, an independent implementation for comparison."""

from __future__ import annotations

import math
from functools import partial
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError, MissingExtraError
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, solve_by
from twinct.recon.checks import Checks
from twinct.recon.order import Order, Rng, view_order
from twinct.recon.shared_keys import Iterations, Nonnegative, Ordering, Relaxation
from twinct.recon.steps import Callback, Listener
from twinct.recon.volume import Volume


class RtkSart(AlgorithmSettings):
    """SART by RTK, the independent cross-check; it needs the extra rtk."""

    algorithm: Literal["rtk_sart"] = "rtk_sart"
    iterations: Iterations = 10
    relaxation: Relaxation = 0.3
    order: Ordering = "golden"
    nonnegative: Nonnegative = False


def rtk_sart(
    line_integrals: ArrayLike,
    geometry: ScanGeometry,
    grid: VolumeGrid,
    *,
    iterations: int,
    relaxation: float,
    x0: ArrayLike | None = None,
    nonnegative: bool = False,
    order: Order = "golden",
    rng: Rng | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct with RTK's SART filter: Joseph forward, voxel-based back projection.

    RTK shuffles its views, so it gets one view at a time, in the same order as ``sart``. Its
    displaced-detector weighting, made for circular orbits, is off. It supports no mask.

    Args:
        line_integrals: (views, rows, columns), mm times the unit of the result.
        geometry: the believed geometry.
        grid: the voxels, anywhere in the world.
        iterations: passes over all views, at least 1.
        relaxation: RTK's lambda, between 0 and 2, both excluded.
        x0: initial volume, (z, y, x); by default zero.
        nonnegative: clip at zero after every update.
        order: as in ``sart``.
        rng: generator or seed of the random order.
        callback: called after each update, with NaN for the residual; True stops.

    Raises:
        MissingExtraError: itk-rtk is not installed.
        InputError: an argument is out of range, has another shape, or is not finite.
    """
    checks = Checks((len(geometry), *geometry.panel.shape))
    p, _ = checks.projections(line_integrals, None)
    iterations = checks.count("iterations", iterations)
    relaxation = checks.relaxation(relaxation)
    x0 = checks.start(x0, grid.shape)
    views = view_order(checks, geometry, order, rng)
    checks.done()
    itk, RTK = _modules()
    x = np.zeros(grid.shape, np.float32) if x0 is None else np.array(x0, np.float32, order="C")
    listener = Listener(callback, len(views))
    local = grid.world_from_grid.inverse() @ geometry
    for iteration in range(iterations):
        for update, view in enumerate(views):
            numbers = local[view].to_rtk()
            stack = np.ascontiguousarray(p[view : view + 1], dtype=np.float32)
            projection = _image(itk, stack, (*numbers["origin"], 0.0), (*numbers["spacing"], 1.0))
            sart = _filter(itk, RTK, relaxation, nonnegative)
            sart.SetInput(0, _image(itk, x, grid.first_voxel_mm, grid.voxel))
            sart.SetInput(1, projection)
            sart.SetGeometry(_geometry(itk, RTK, numbers))
            sart.Update()
            x = itk.array_from_image(sart.GetOutput())
            if listener(iteration, update, math.nan, 1, x):
                return Volume(np.array(x), grid)
    return Volume(x, grid)


def _modules() -> tuple[Any, Any]:
    try:
        # itk creates its names at import, so the type checker cannot find them.
        itk: Any = import_module("itk")
        return itk, itk.RTK
    except (ImportError, AttributeError) as error:
        raise MissingExtraError("itk-rtk", "rtk") from error


def _filter(itk: Any, RTK: Any, relaxation: float, nonnegative: bool) -> Any:
    """Return the filter for one pass over one view."""
    image_type = itk.Image[itk.F, 3]
    sart = RTK.SARTConeBeamReconstructionFilter[image_type, image_type].New()
    sart.SetNumberOfIterations(1)
    sart.SetNumberOfProjectionsPerSubset(1)
    sart.SetDisableDisplacedDetectorFilter(True)
    sart.SetLambda(float(relaxation))
    sart.SetEnforcePositivity(bool(nonnegative))
    return sart


def _image(itk: Any, array: NDArray[np.float32], origin: Any, spacing: Any) -> Any:
    image = itk.image_view_from_array(array)
    image.SetOrigin([float(value) for value in origin])
    image.SetSpacing([float(value) for value in spacing])
    return image


def _geometry(itk: Any, RTK: Any, numbers: dict[str, Any]) -> Any:
    geometry = RTK.ThreeDCircularProjectionGeometry.New()
    points = [itk.Point[itk.D, 3](numbers[name][0].tolist()) for name in ("source", "detector")]
    vectors = [itk.Vector[itk.D, 3](numbers[name][0].tolist()) for name in ("row", "column")]
    if not geometry.AddProjection(*points, *vectors):
        raise InputError(f"RTK rejects the view with its source at {numbers['source'][0]} mm")
    return geometry


RTK_SART = Algorithm(
    RtkSart, partial(solve_by, rtk_sart), volumes=4, masks=False, updates=lambda _, views: views
)
