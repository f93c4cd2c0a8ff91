"""Grey parts from CT volumes: values to mixtures, what counts, skin and cut faces."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.geometry import Pose, VolumeGrid
from twinct.specimen import sections
from twinct.specimen.ct_grid import canonical, right_angled
from twinct.specimen.ct_image import AIR_HU, CtImage
from twinct.specimen.cut_rays import CutFace
from twinct.specimen.grey import GreyField
from twinct.specimen.grey_part import GreyPart, VoxelLabels
from twinct.specimen.hounsfield import TissueLine, line_of, values_line
from twinct.specimen.materials import Material
from twinct.specimen.phantom import phantom_ct
from twinct.specimen.surface import isosurface, simplified, surface
from twinct.specimen.volumes import read_ct
from twinct.specimen.voxel_labels import read_labels, read_mask

if TYPE_CHECKING:
    import trimesh

log = logging.getLogger(__name__)

SKIN_MM = 3.0
"""Voxel edge up to which voxels are averaged for the skin: finer triangles show nothing more."""

SKIN_TRIANGLES = 200_000
"""Maximum number of the skin's triangles."""

SLOPE_VOXELS = 2
"""Voxels around the body that also count: its surface is blurred there."""

SMALLEST_RANGE_HU = 50.0
"""Range of values below which they are no HU of a body in air."""

BLANK = 0.1
"""Share of voxels at exactly 0, the lowest value, from which 0 is no water but nothing."""

PADDING_HU = -1100.0
"""Values below this are padding outside the scanner's field of view."""

LARGEST_EDGE_CM2 = 5.0
"""Area of tissue beside such padding that is named."""

SMALLEST_CUT = 1e-3
"""Share of a face that must hold tissue, so that the face cuts the body."""

_TOUCHING = np.ones((3, 3, 3), dtype=bool)


@dataclass(frozen=True, eq=False)
class _Voxels:
    """Values in HU on a right-angled grid in the part's frame, (z, y, x); nothing is AIR_HU."""

    hu: NDArray[np.float32]
    labels: VoxelLabels | None
    grid: VolumeGrid


def grey_part(
    shape: sections.GreyVolume, name: str, reference: Material, specimen_from_part: Pose, key: str
) -> GreyPart:
    """Read a CT volume and return it as a grey part in the specimen's frame.

    Args:
        shape: file, calibration, and what counts.
        name: name of the part.
        reference: its reference material.
        specimen_from_part: pose of the part.
        key: key of the shape, for messages.

    Raises:
        SpecimenError: a file cannot be used, or nothing of it counts; names the part.
    """
    where = f"part {name!r}: {shape.source}"
    sharp = shape.edges == "sharp"
    line = line_of(shape.calibration, f"{key}.calibration", pure=sharp)
    voxels = _counting(*_read(shape, where), shape, where)
    if shape.extend_mm:
        voxels = _extended(voxels, shape.extend_mm)
    cuts = _cuts(voxels, shape.surface_hu)
    skin = _skin(voxels, shape, where)
    if shape.centre:
        shift = -skin.bounds.mean(axis=0)
        specimen_from_part = specimen_from_part @ Pose(shift, np.array([0.0, 0.0, 0.0, 1.0]))
    skin = surface(specimen_from_part.apply(skin.vertices), skin.faces)
    field, labels, cuts = _field(voxels, line, cuts, specimen_from_part, where)
    return GreyPart(name, reference, skin, replace(field, sharp=sharp), labels, cuts)


def _read(
    shape: sections.GreyVolume, where: str
) -> tuple[CtImage, tuple[str, ...], NDArray[np.uint16] | None]:
    """Return a file's CT volume or the phantom, with names and labels, if any."""
    if shape.phantom:
        return phantom_ct(shape.phantom, shape.seed, shape.voxel_mm)
    assert shape.path is not None
    line = shape.hu or values_line(shape.calibration)
    image = read_ct(shape.path, where, line, interpolate=shape.interpolate_slices)
    image = canonical(image)
    _require_plausible(image, shape, where)
    _warn_of_edge(image, shape, where)
    if shape.labels is None:
        return image, (), None
    names, numbers = read_labels(shape.labels, image, where)
    return image, names, numbers


def _require_plausible(image: CtImage, shape: sections.GreyVolume, where: str) -> None:
    """Check that values are what the part says: HU, or attenuation."""
    low, high = float(image.values.min()), float(image.values.max())
    if shape.calibration.kind == "attenuation":
        if low < 3 * AIR_HU or high < SMALLEST_RANGE_HU + AIR_HU or high > 1e5:
            raise SpecimenError(
                f"{where}: its values would lie between {low:.4g} and {high:.4g} HU; are they "
                f"attenuation in {shape.calibration.unit}?"
            )
        return
    if high - low < SMALLEST_RANGE_HU:
        raise SpecimenError(
            f"{where}: its values lie between {low:.4g} and {high:.4g}, so that they are no HU; if "
            "they are attenuation, state it: calibration: {kind: attenuation, energy_kev: ...}"
        )
    if high <= shape.surface_hu:
        raise SpecimenError(
            f"{where}: no value exceeds surface_hu {shape.surface_hu:g}; its values lie between "
            f"{low:g} and {high:g} HU"
        )
    above_hu = AIR_HU if shape.above_hu is None else shape.above_hu
    selected = shape.mask or shape.keep == "labelled" or above_hu >= 0
    if low == 0 and not selected and (share := float(np.mean(image.values == 0))) > BLANK:
        raise SpecimenError(
            f"{where}: {share:.0%} of its values are 0, and none is below, so that 0 is air, which "
            "has -1000 HU: are they attenuation, or stored numbers that the key hu turns to HU?"
        )
    if low > AIR_HU / 2:
        log.warning(
            "%s: its lowest value is %g HU, so that it holds no air; are its values HU?", where, low
        )


def _warn_of_edge(image: CtImage, shape: sections.GreyVolume, where: str) -> None:
    """Warn if tissue reaches the padding around a round field of view, as cut shoulders do."""
    padding = image.values < PADDING_HU
    if not padding.any():
        return
    tissue, area = image.values > shape.surface_hu, 0.0
    for axis in (0, 1):
        other = np.delete(image.voxel_mm, axis)
        a, b = (np.moveaxis(mask, axis, 0) for mask in (tissue, padding))
        touching = np.count_nonzero(a[1:] & b[:-1]) + np.count_nonzero(a[:-1] & b[1:])
        area += touching * float(other[0] * other[1]) / 100
    if area > LARGEST_EDGE_CM2:
        log.warning(
            "%s: its field of view cuts the body: %.0f cm2 of tissue touch the padding around it",
            where,
            area,
        )


def _counting(
    image: CtImage,
    names: tuple[str, ...],
    numbers: NDArray[np.uint16] | None,
    shape: sections.GreyVolume,
    where: str,
) -> _Voxels:
    """Return the voxels that count; all others are air."""
    values = np.maximum(image.values, np.float32(AIR_HU))
    counting = np.ones(values.shape, dtype=np.bool_)
    if shape.above_hu is not None:
        counting &= values > shape.above_hu
    if shape.mask:
        counting &= read_mask(shape.mask.path, image, where)
    if shape.keep == "labelled" and numbers is not None:
        counting &= numbers > 0
    if shape.keep == "body":
        counting &= _body(np.where(counting, values, np.float32(AIR_HU)), shape.surface_hu)
    values = np.where(counting, values, np.float32(AIR_HU))
    if not values.max() > shape.surface_hu:
        raise SpecimenError(f"{where}: nothing that counts exceeds surface_hu {shape.surface_hu:g}")
    hu, numbers, grid = right_angled(CtImage(values, image.affine), AIR_HU, numbers)
    return _Voxels(hu, VoxelLabels(names, numbers) if numbers is not None else None, grid)


def _body(values: NDArray[np.float32], level: float) -> NDArray[np.bool_]:
    """Return the largest connected piece above a level, with its cavities and its slope."""
    pieces = np.empty(values.shape, dtype=np.int32)
    count = int(scipy.ndimage.label(values > level, output=pieces))  # type: ignore[call-overload]
    sizes = np.zeros(count + 1, dtype=np.int64)
    for plane in pieces:  # a whole volume would be copied as 64-bit numbers
        sizes += np.bincount(plane.ravel(), minlength=count + 1)
    sizes[0] = 0
    body = _filled(pieces == int(sizes.argmax()))
    return scipy.ndimage.binary_dilation(body, _TOUCHING, iterations=SLOPE_VOXELS)


def _filled(body: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a body with its cavities, in space and in each slice: airways may reach an end."""
    for k in range(body.shape[2]):
        body[:, :, k] = scipy.ndimage.binary_fill_holes(body[:, :, k])
    return body


def _extended(voxels: _Voxels, length_mm: float) -> _Voxels:
    """Repeat the first and the last slice."""
    count = int(np.ceil(length_mm / voxels.grid.voxel[2] - 1e-9))
    ends = ((count, count), (0, 0), (0, 0))
    nz, ny, nx = voxels.grid.shape
    grid = VolumeGrid((nz + 2 * count, ny, nx), voxels.grid.voxel, voxels.grid.world_from_grid)
    labels = voxels.labels
    if labels:
        labels = VoxelLabels(labels.names, np.pad(labels.values, ends, mode="edge"))
    return _Voxels(np.pad(voxels.hu, ends, mode="edge"), labels, grid)


def _cuts(voxels: _Voxels, level: float) -> tuple[CutFace, ...]:
    """Return the faces of a volume that hold tissue."""
    cuts = []
    for axis in range(3):
        for high in (False, True):
            layer = np.moveaxis(voxels.hu, 2 - axis, 0)[-1 if high else 0]
            tissue = np.asarray(layer > level)
            if tissue.mean() > SMALLEST_CUT:
                cuts.append(CutFace(axis, high, tissue))
    return tuple(cuts)


def _skin(voxels: _Voxels, shape: sections.GreyVolume, where: str) -> trimesh.Trimesh:
    """Return the closed surface around the body and its cavities, in the part's frame."""
    factors = np.maximum(np.floor(SKIN_MM / voxels.grid.voxel + 1e-9).astype(int), 1)[::-1]
    hu = _averaged(voxels.hu, factors)
    level = shape.surface_hu
    outside = np.empty(hu.shape, dtype=np.int32)
    scipy.ndimage.label(
        np.pad(hu <= level, 1, constant_values=True)[1:-1, 1:-1, 1:-1], output=outside
    )
    borders = [outside.take(end, axis) for axis in range(3) for end in (0, -1)]
    touching = np.unique(np.concatenate([border.ravel() for border in borders]))
    cavity = (outside > 0) & ~np.isin(outside, touching)
    hu[cavity] = hu.max()
    if not (hu > level).any():
        raise SpecimenError(f"{where}: the body above {level:g} HU is smaller than {SKIN_MM:g} mm")
    affine = voxels.grid.affine.copy()
    if (hu > level).all():  # cut out of a body: the skin is the box
        hu = np.pad(hu, 1, constant_values=AIR_HU)
        affine[:3, 3] -= affine[:3, :3] @ factors[::-1]
    affine[:3, 3] += affine[:3, :3] @ ((factors[::-1] - 1) / 2)
    affine[:3, :3] *= factors[::-1]
    mesh = simplified(isosurface(hu.transpose(2, 1, 0), level, affine), SKIN_TRIANGLES)
    if not mesh.is_watertight:
        raise SpecimenError(f"{where}: the surface at {level:g} HU does not close")
    return mesh


def _averaged(values: NDArray[np.float32], factors: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return means over blocks of voxels; the last block repeats the outermost voxel."""
    ends = [(0, -n % f) for n, f in zip(values.shape, factors, strict=True)]
    padded = np.pad(values, ends, mode="edge")
    shape = [n for size, f in zip(padded.shape, factors, strict=True) for n in (size // f, f)]
    return padded.reshape(shape).mean(axis=(1, 3, 5), dtype=np.float32)


def _field(
    voxels: _Voxels,
    line: TissueLine,
    cuts: tuple[CutFace, ...],
    specimen_from_part: Pose,
    where: str,
) -> tuple[GreyField, VoxelLabels | None, tuple[CutFace, ...]]:
    """Return the mixtures in the smallest box around them, with an empty layer of voxels around."""
    filled = voxels.hu > max(AIR_HU, line.nothing_hu)
    axes = [np.flatnonzero(filled.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    if any(not len(at) for at in axes):
        raise SpecimenError(f"{where}: no voxel attenuates, by its calibration")
    box = tuple(slice(int(at[0]), int(at[-1]) + 1) for at in axes)
    hu = voxels.hu[box]
    shape = tuple(n + 2 for n in hu.shape)
    amounts = np.zeros((*shape, len(line.materials)), dtype=np.float32)
    for k, layer in enumerate(hu):  # whole volumes in double precision take much memory
        amounts[k + 1, 1:-1, 1:-1] = line(layer)
    labels = voxels.labels
    if labels:
        labels = VoxelLabels(labels.names, np.pad(labels.values[box], 1))
    start = np.array([side.start - 1 for side in box[::-1]])
    first = voxels.grid.first_voxel_mm + start * voxels.grid.voxel
    middle = first + (np.array(shape[::-1]) - 1) / 2 * voxels.grid.voxel
    shift = Pose(middle, np.array([0.0, 0.0, 0.0, 1.0]))
    pose = specimen_from_part @ voxels.grid.world_from_grid @ shift
    grid = VolumeGrid(shape, voxels.grid.voxel, pose)
    cut_faces = tuple(
        CutFace(
            face.axis,
            face.high,
            np.pad(face.tissue[tuple(side for a, side in enumerate(box) if a != 2 - face.axis)], 1),
        )
        for face in cuts
    )
    return GreyField(line.materials, amounts, grid), labels, cut_faces
