"""Metal artefact reduction: a prior image replaces the line integrals of rays through metal.

This is normalised metal artefact reduction, for any algorithm. A first volume, by ``sart`` of all
line integrals, locates the metal and classifies the rest. The prior contains air, tissue and bone,
each with its own attenuation, and tissue in place of metal. A voxel is classified by its share of
the step from air to tissue, or from tissue to bone: below a quarter as the lower material, above
three quarters as the higher, in between in proportion. The measured line integrals are divided by
the prior's. The ratio is smooth and close to 1. It is interpolated from the rays beside the metal
into the rays through metal, in both directions of the panel, by Laplace's equation, and multiplied
by the prior's line integrals again.

The metal is put back with the attenuation that fits the difference of the line integrals
(``metal_density``), at most its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.recon.checks import Checks, Mask, mask_of, masked_image
from twinct.recon.engine import Singles
from twinct.recon.memory import SPARE_BYTES, advice, refuse_if_short
from twinct.recon.metal_density import MetalIntegrals, fitted_excess
from twinct.recon.projector import Projector
from twinct.recon.sart import sart
from twinct.recon.steps import Callback
from twinct.recon.volume import Volume

OFFSET_MM = 20.0
"""Path in tissue that is added to both line integrals before their division.

A ray that misses the prior would have no ratio otherwise. Between 2 mm and 10 m of path, the errors
changed by 3 % of their size.
"""


UNLIKE = 0.15
"""Relative deviation from the attenuation of the metal named, above which it may be another."""

_NO_EXCESS = np.empty(0, dtype=np.intp), np.empty(0, dtype=np.float32)

Excess = Callable[[int, Singles], Singles]
"""Function of a view and its line integrals without metal, (rows, columns): those of the metal."""


@dataclass(frozen=True, eq=False)
class WithoutMetal:
    """Line integrals as if there were no metal, and the metal.

    Attributes:
        line_integrals: (views, rows, columns), float32; the given ones where no ray passes metal.
        voxels: flat indices of the metal voxels in (z, y, x).
        threshold: smallest value of a metal voxel in the first volume, 1/mm.
        densest: largest value of the first volume.
        near: flat indices of the metal voxels and their neighbours.
        excess: attenuation of the metal beyond its surroundings in these voxels, float32, 1/mm.
        density_rel: mean attenuation of voxels surrounded by metal, relative to the metal's own;
            None if there are none.
        thin: number of metal voxels in parts without such a voxel, whose density is uncertain.
    """

    line_integrals: NDArray[Any]
    voxels: NDArray[np.intp]
    threshold: float
    densest: float
    near: NDArray[np.intp]
    excess: Singles
    density_rel: float | None = None
    thin: int = 0

    @property
    def as_named(self) -> bool:
        """False if the metal found attenuates otherwise than the metal named."""
        return self.density_rel is None or abs(self.density_rel - 1) <= UNLIKE

    @property
    def quantitative(self) -> bool:
        """False if the density of some metal is uncertain or is not that of the metal named."""
        return self.as_named and not self.thin

    def put_back(self, volume: Volume) -> Volume:
        """Return a volume with the metal put back, and ``metal_voxels`` in its extras.

        If there is metal, the extras also hold ``metal_density_rel`` and ``metal_thin_voxels``.
        """
        extras = {**volume.extras, "metal_voxels": self.voxels.size}
        if not self.voxels.size:
            return Volume(volume.array, volume.grid, extras)
        array = np.array(volume.array)
        array.flat[self.near] += self.excess
        extras |= {"metal_density_rel": self.density_rel, "metal_thin_voxels": self.thin}
        return Volume(array, volume.grid, extras)


def without_metal(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    tissue: float,
    bone: float,
    metal: float,
    threshold: float | None = None,
    first_iterations: int = 3,
    relaxation: float = 0.3,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
    fit: Excess | bool = True,
) -> WithoutMetal:
    """Replace the line integrals of rays through metal (Meyer et al., Med Phys 37, 2010).

    If something lies around the grid, remove it first (``without_surroundings``): the prior does
    not contain it.

    Peak memory: 2.25 volumes and the projections once, besides the input.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        tissue: attenuation of soft tissue, 1/mm.
        bone: attenuation of bone, above tissue.
        metal: attenuation of the metal, above bone.
        threshold: smallest attenuation of metal in the first volume; by default the geometric mean
            of bone and metal.
        first_iterations: iterations of the first ``sart``.
        relaxation: relaxation of the first ``sart``.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        callback: callback of the first ``sart``.
        fit: line integrals of the metal's excess over its surroundings, from which the metal's
            attenuation is fitted; True for the difference of the line integrals, which is right
            for one energy only; False leaves the metal out.

    Returns:
        The line integrals, and the metal for the volume that is reconstructed from them. Without
        metal the line integrals are the given ones.

    Raises:
        InputError: the attenuations do not rise, every ray of a view passes metal, or as in
            ``sart``.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    if not 0 < tissue < bone < metal < math.inf:
        checks.problems.append(
            f"tissue, bone and metal are {tissue:g}, {bone:g} and {metal:g} per mm; they must be "
            "above 0 and in ascending order"
        )
    checks.done()
    refuse_if_short(
        metal_bytes(math.prod(A.domain_shape), p.size),
        f"replacing metal on a grid of {A.domain_shape} voxels",
        advice(),
    )
    first = sart(
        A, p, iterations=first_iterations, relaxation=relaxation, mask=pixels, callback=callback
    ).array
    least = math.sqrt(bone * metal) if threshold is None else threshold
    voxels = np.flatnonzero(first >= np.float32(least))
    result = voxels, least, float(first.max())
    if not voxels.size:
        return WithoutMetal(p, *result, *_NO_EXCESS)
    prior = _classified(first, tissue, bone)
    prior.flat[voxels] = tissue
    del first
    solid = np.zeros_like(prior)
    solid.flat[voxels] = 1.0
    replaced, lost = _replaced(A, p, pixels, prior, solid, OFFSET_MM * tissue)
    if lost:
        few = ", ".join(map(str, lost[:8])) + (", ..." if len(lost) > 8 else "")
        raise InputError(
            f"every ray of {len(lost)} of {len(A)} views ({few}) passes through metal, so "
            f"nothing is left to replace it with: {voxels.size} of {solid.size} voxels attenuate "
            f"by at least the threshold of {least:.3g} per mm, the densest by {result[-1]:.3g}"
        )
    done = WithoutMetal(replaced, *result, *_NO_EXCESS)
    if fit is False:
        return done

    def excess(view: int) -> Singles:
        given = replaced[view]
        return masked_image(p, view, pixels) - given if fit is True else fit(view, given)

    return _fitted(done, A, solid > 0, excess, pixels, tissue, metal)


def _fitted(
    without: WithoutMetal,
    A: Projector,
    there: NDArray[np.bool_],
    integrals: MetalIntegrals,
    mask: Mask | None,
    tissue: float,
    metal: float,
) -> WithoutMetal:
    """Return the result with the excess of its metal, at most that of the metal named."""
    near, excess = fitted_excess(A, there, integrals, mask)
    surrounded = scipy.ndimage.binary_erosion(there)
    inner = surrounded.flat[near]
    density = float(excess[inner].mean() + tissue) / metal if inner.any() else None
    thin = _thin(there, surrounded)
    done = replace(without, near=near, excess=excess, density_rel=density, thin=thin)
    if done.as_named:
        np.minimum(excess, np.float32(metal - tissue), out=excess)
    return done


def _thin(there: NDArray[np.bool_], surrounded: NDArray[np.bool_]) -> int:
    """Return the number of voxels in connected parts that have no surrounded voxel."""
    boxes = scipy.ndimage.find_objects(there.view(np.uint8))  # metal takes little of a volume
    if not boxes:
        return 0
    inside = there[boxes[0]]
    parts, number = scipy.ndimage.label(inside)
    thick = np.zeros(number + 1, bool)
    thick[parts[surrounded[boxes[0]]]] = True
    return int(np.count_nonzero(inside & ~thick[parts]))


def metal_bytes(voxels: int, pixels: int) -> int:
    """Return the bytes that ``without_metal`` needs besides its input; pixels of all views."""
    return int(4 * (2.25 * voxels + pixels)) + SPARE_BYTES


def _classified(volume: Singles, tissue: float, bone: float) -> Singles:
    """Return a volume of air, tissue and bone, each with its own attenuation."""
    prior = np.empty_like(volume)
    for plane, given in zip(prior, volume, strict=True):
        bones = _share(given, tissue, bone)
        plane[:] = tissue * _share(given, 0.0, tissue) + (bone - tissue) * bones
    return prior


def _share(values: Singles, low: float, high: float) -> Singles:
    """Return the share of a step: 0 up to a quarter, 1 from three quarters, to ignore noise."""
    return np.clip(2 * (values - low) / (high - low) - 0.5, 0, 1).astype(np.float32)


def _replaced(
    A: Projector, p: NDArray[Any], mask: Mask | None, prior: Singles, solid: Singles, offset: float
) -> tuple[Singles, list[int]]:
    """Return the line integrals with rays through ``solid`` replaced, and the lost views.

    Replacements come from the prior and the neighbouring rays. A lost view has no ray left.
    """
    neighbours = _laplacian(A.range_shape[1:])
    replaced = np.array(p, dtype=np.float32)
    lost: list[int] = []
    for view, image in enumerate(replaced):
        counts = True if mask is None else mask_of(mask, view)
        hidden = (A[view](solid)[0] > 0) & counts
        if not hidden.any():
            continue
        unknown = hidden | ~np.broadcast_to(counts, hidden.shape)
        if unknown.all():
            lost.append(view)
            continue
        expected = A[view](prior)[0] + offset
        ratio = (masked_image(p, view, mask) + offset) / expected
        image[hidden] = (_filled(ratio, unknown, neighbours) * expected - offset)[hidden]
    return replaced, lost


def _laplacian(shape: tuple[int, ...]) -> Any:
    """Return the negative Laplacian of an image as a sparse matrix, (pixels, pixels)."""
    rows, columns = (scipy.sparse.diags([-1.0, 1.0], [0, 1], shape=(n - 1, n)) for n in shape)
    down, right = (
        scipy.sparse.kron(rows, scipy.sparse.eye(shape[1])),
        scipy.sparse.kron(scipy.sparse.eye(shape[0]), columns),
    )
    steps = scipy.sparse.vstack([down, right])
    return (steps.T @ steps).tocsr()


def _filled(image: Singles, unknown: Mask, neighbours: Any) -> Singles:
    """Return the image with each unknown pixel as the mean of its neighbours (Laplace's equation).

    Nothing flows over the border of the panel.
    """
    known = np.flatnonzero(~unknown)
    there = np.flatnonzero(unknown)
    rows = neighbours[there]
    filled = image.copy()
    right = -(rows[:, known] @ image.flat[known].astype(np.float64))
    filled.flat[there] = scipy.sparse.linalg.spsolve(rows[:, there].tocsc(), right)
    return filled
