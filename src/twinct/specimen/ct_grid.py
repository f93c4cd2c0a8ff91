"""CT volumes on a grid with axes at right angles, nearest to the patient's axes."""

from __future__ import annotations

import itertools
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.specimen.ct_image import CtImage

SHEAR_TOLERANCE = 0.05
"""Largest shift of a corner by which axes may differ from right angles, in voxel edges."""

PLACE_TOLERANCE = 0.1
"""Largest distance of corners in two equal grids, in voxel edges."""


def canonical(image: CtImage) -> CtImage:
    """Return an image with its index axes in the order and direction nearest to x, y, z."""
    from nibabel import orientations

    order = orientations.io_orientation(image.affine)
    values = orientations.apply_orientation(image.values, order)
    affine = image.affine @ orientations.inv_ornt_aff(order, image.values.shape)
    return CtImage(np.asarray(values, dtype=np.float32), affine)


def same_place(a: CtImage, b: CtImage) -> bool:
    """Return True if two images have the same voxels."""
    if a.values.shape != b.values.shape:
        return False
    corners = _corners(a.values.shape)
    apart = np.linalg.norm((corners @ (a.affine - b.affine).T)[:, :3], axis=1).max()
    return bool(apart <= PLACE_TOLERANCE * a.voxel_mm.min())


def right_angled(
    image: CtImage, outside: float, labels: NDArray[np.uint16] | None
) -> tuple[NDArray[np.float32], NDArray[np.uint16] | None, VolumeGrid]:
    """Return values and labels as (z, y, x) on a grid in the patient's axes, mm.

    A sheared volume, such as of a tilted gantry, is interpolated linearly, its labels take the
    nearest. x stays along the rows, y in the plane of the slices.

    Args:
        image: image in ``canonical`` order.
        outside: value outside a sheared volume.
        labels: label of each voxel, in the image's order.
    """
    matrix = image.affine[:3, :3]
    axes, voxel = _nearest_rotation(matrix), image.voxel_mm
    shape = np.array(image.values.shape)
    shift = np.abs(np.linalg.solve(axes * voxel, matrix) - np.eye(3)) @ shape
    if shift.max() <= SHEAR_TOLERANCE:
        middle = image.affine @ [*((shape - 1) / 2), 1]
        grid = VolumeGrid(shape[::-1].tolist(), voxel, Pose.from_matrix(middle[:3], axes))
        turned = None if labels is None else np.ascontiguousarray(labels.transpose(2, 1, 0))
        return np.ascontiguousarray(image.values.transpose(2, 1, 0)), turned, grid
    axes, upper = np.linalg.qr(matrix)
    signs = np.sign(np.diag(upper))
    axes, voxel = axes * signs, np.abs(np.diag(upper))
    corners = (_corners(image.values.shape) @ image.affine.T)[:, :3] @ axes
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = np.floor((high - low) / voxel + 1.5).astype(int)
    grid = VolumeGrid(
        size[::-1].tolist(), voxel, Pose.from_matrix(axes @ (low + (size - 1) / 2 * voxel), axes)
    )
    back = np.linalg.inv(image.affine) @ grid.affine

    def moved(values: NDArray[Any], order: Literal[0, 1], fill: float) -> NDArray[Any]:
        resampled = scipy.ndimage.affine_transform(
            values,
            back[:3, :3],
            back[:3, 3],
            output_shape=tuple(size.tolist()),
            order=order,
            cval=fill,
        )
        return np.ascontiguousarray(resampled.transpose(2, 1, 0))

    return moved(image.values, 1, outside), None if labels is None else moved(labels, 0, 0), grid


def _nearest_rotation(matrix: Floats) -> Floats:
    left, _, right = np.linalg.svd(matrix / np.linalg.norm(matrix, axis=0))
    return left @ right


def _corners(shape: tuple[int, ...]) -> Floats:
    ends = itertools.product(*((0, n - 1) for n in shape))
    return np.array([[*corner, 1.0] for corner in ends])
