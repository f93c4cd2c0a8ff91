"""RTK's SART on the CPU, an independent implementation to compare with."""

# itk makes its names when it is imported, so the type checker finds none of them.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError, MissingExtraError
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.projector import Volume
from twinct.recon.sart import Callback, check_arguments


def rtk_sart(
    line_integrals: ArrayLike,
    geometry: ScanGeometry,
    grid: VolumeGrid,
    *,
    iterations: int,
    relaxation: float,
    order: Sequence[int] | NDArray[np.integer] | None = None,
    x0: ArrayLike | None = None,
    nonnegative: bool = False,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct with RTK's SART filter: Joseph forward, voxel-based back projection.

    RTK shuffles the views it is given, so it gets one at a time, in the same order as ``sart``. Its
    displaced detector weighting, made for circular orbits, is off.

    Args:
        line_integrals: (views, rows, columns), mm times the unit of the result.
        geometry: the believed geometry.
        grid: the voxels, anywhere in the world.
        iterations: passes over all views, at least 1.
        relaxation: RTK's lambda, between 0 and 2, both excluded.
        order: permutation of the views; ``spread_order`` if not given.
        x0: start, (z, y, x); zero if not given.
        nonnegative: clip at zero after every update.
        callback: called as ``callback(iteration, update, x)`` after each update.

    Returns:
        The volume (z, y, x), float32.

    Raises:
        MissingExtraError: itk-rtk is not installed.
        InputError: an argument is out of range, has another shape, or is not finite.
    """
    range_shape = (len(geometry), *geometry.panel.shape)
    order = check_arguments(range_shape, line_integrals, iterations, relaxation, order)
    try:
        import itk
        from itk import RTK
    except ImportError as error:
        raise MissingExtraError("itk-rtk", "rtk") from error

    p = np.asarray(line_integrals)
    x = np.zeros(grid.shape, np.float32) if x0 is None else np.array(x0, np.float32, order="C")
    if x.shape != grid.shape:
        raise InputError(f"x0 has shape {x.shape}: the grid needs {grid.shape} (z, y, x)")
    local = grid.world_from_grid.inverse() @ geometry
    image_type = itk.Image[itk.F, 3]
    volume_origin = -(np.array(grid.shape_xyz) - 1) / 2 * grid.voxel
    for iteration in range(iterations):
        for update, view in enumerate(order):
            numbers = local[view].to_rtk()
            volume = _image(itk, x, volume_origin, grid.voxel)
            stack = np.ascontiguousarray(p[view : view + 1], dtype=np.float32)
            projection = _image(itk, stack, (*numbers["origin"], 0.0), (*numbers["spacing"], 1.0))
            sart = RTK.SARTConeBeamReconstructionFilter[image_type, image_type].New()
            sart.SetInput(0, volume)
            sart.SetInput(1, projection)
            sart.SetGeometry(_geometry(itk, RTK, numbers))
            sart.SetNumberOfIterations(1)
            sart.SetNumberOfProjectionsPerSubset(1)
            sart.SetLambda(float(relaxation))
            sart.SetEnforcePositivity(bool(nonnegative))
            sart.SetDisableDisplacedDetectorFilter(True)
            sart.Update()
            x = itk.array_from_image(sart.GetOutput())
            if callback is not None:
                callback(iteration, update, x)
    return np.ascontiguousarray(x, dtype=np.float32)


def _image(itk: Any, array: NDArray[np.float32], origin: Any, spacing: Any) -> Any:
    image = itk.image_view_from_array(array)
    image.SetOrigin([float(value) for value in origin])
    image.SetSpacing([float(value) for value in spacing])
    return image


def _geometry(itk: Any, RTK: Any, numbers: dict[str, Any]) -> Any:  # noqa: N803
    geometry = RTK.ThreeDCircularProjectionGeometry.New()
    points = [itk.Point[itk.D, 3](numbers[name][0].tolist()) for name in ("source", "detector")]
    vectors = [itk.Vector[itk.D, 3](numbers[name][0].tolist()) for name in ("row", "column")]
    if not geometry.AddProjection(*points, *vectors):
        raise InputError(f"RTK refuses the view with source {numbers['source'][0]} mm")
    return geometry
