"""Stacks of stored images of any supported format, read image by image."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.boundary import file_bytes, library_errors, no_file, require_memory
from twinct.core.files.metaimage import metaimage_header, read_metaimage
from twinct.core.files.packed import require_growth
from twinct.core.foreign_text import quoted, whole_number
from twinct.measured.array_names import array_name
from twinct.measured.description import Files
from twinct.measured.dicom_images import MOST_LISTED, dicom_files, is_dicom
from twinct.measured.hdf5_images import HDF5, open_hdf5
from twinct.measured.numbers import MOST_BYTES
from twinct.measured.zarr_images import is_zarr, open_zarr

if TYPE_CHECKING:
    from twinct.core.files.plain_tiff import PlainTiff

Image = NDArray[Any]

_TIFF = (".tif", ".tiff")
_PICTURES = (".png", ".bmp", ".pgm", ".jpg", ".jpeg")
_DICOM = (".dcm", ".ima", "")
_RAW = (".raw", ".bin", ".img", ".dat", ".vol")
_IMAGES = {*_TIFF, *_PICTURES, *_DICOM, *_RAW, *HDF5, ".npy", ".npz", ".mha", ".mhd"}

ZEISS = (".txrm", ".xrm", ".txm")
NO_ZEISS = (
    "files of Zeiss are not read: convert the projections to TIFF, such as with txrm2tiff, and "
    "state distances, pitch and angles as kind: circle in a YAML file (docs/measured.md)"
)
"""Reason: no real file is public with which a reader, and its sense of rotation, can be tested."""

MOST_GAP = 1000
"""Largest number of missing files in a row that are listed."""

IMAGE_FACTOR = 160
"""Bytes in memory per pixel while an image is corrected, between its neighbours: 20 images in
double precision."""


@dataclass(frozen=True)
class Stack:
    """Images of one size.

    Attributes:
        where: path, for messages.
        count: number of images.
        shape: (rows, columns).
        dtype: number type as stored.
        image: returns an image, (rows, columns), by its index.
        spacing: pitch along (columns, rows) that the file states, mm, or None.
        first_pixel: place of pixel (0, 0) on the panel that the file states, mm, or None.
        exchangeable: True for an array, whose axes may be named in another order.
        notes: sentences on files that are no images of this stack.
        missing: numbers that are missing among those of the files' names.
    """

    where: str
    count: int
    shape: tuple[int, int]
    dtype: np.dtype
    image: Callable[[int], Image]
    spacing: tuple[float, float] | None = None
    first_pixel: tuple[float, float] | None = None
    exchangeable: bool = False
    notes: tuple[str, ...] = ()
    missing: tuple[int, ...] = ()


def open_stack(section: Files, key: str) -> Stack:
    """Return the stack that a section names.

    Args:
        section: the section.
        key: its dotted name, for messages.

    Raises:
        InputError: there are no such images, they have several sizes, or are not readable.
        MissingExtraError: HDF5 needs a package that is not installed.
    """
    path = Path(section.path)
    with library_errors(f"{path}"):
        if is_zarr(path):
            files = [file for file in path.rglob("*") if file.is_file()]
            stack = _of_array(open_zarr(path, section.array, key), section, f"{path}")
        else:
            files, notes = _images_of(path, _files(path, key))
            stack = _stack_of(path, files, section, key)
            stack = replace(stack, notes=(*notes, *stack.notes), missing=_missing(files))
        return _bounded(stack, sum(file.stat().st_size for file in files))


def _bounded(stack: Stack, packed: int) -> Stack:
    """Return a stack whose images fit into the memory, and whose errors name the image."""
    pixels = math.prod(stack.shape)
    require_growth(packed, stack.count * pixels * stack.dtype.itemsize, stack.where)
    require_memory(f"{stack.where}: an image", IMAGE_FACTOR * pixels)

    def image(index: int) -> Image:
        with library_errors(f"{stack.where}: image {index}"):
            return stack.image(index)

    return replace(stack, image=image)


def _stack_of(path: Path, files: Sequence[Path], section: Files, key: str) -> Stack:
    suffix = files[0].suffix.lower()
    alike = _DICOM if suffix in _DICOM else (suffix,)
    if others := sorted({f.suffix.lower() for f in files}.difference(alike)):
        raise InputError(
            f"{key}.path: {path} holds files of several kinds ({suffix or 'without ending'}, "
            f"{', '.join(other or 'without ending' for other in others)}): name a pattern such as "
            f"*{suffix or others[0]}"
        )
    if section.series is not None and suffix not in _DICOM:
        raise InputError(f"{key}.series: only for DICOM files, not for {files[0].name}")
    if len(files) == 1 and suffix in (".npy", ".npz", ".mha", ".mhd", *HDF5):
        readers = {".npy": _npy, ".npz": _npz, ".mha": _metaimage, ".mhd": _metaimage}
        return readers.get(suffix, _hdf5)(files[0], section, key)
    if suffix in _RAW:
        return _raw(files, section, key)
    if suffix in _TIFF:
        return _joined(files, list(_tiffs(files)))
    if suffix in _DICOM:
        return _dicom(files, section, key)
    if suffix == ".npy":
        return _joined(files, [_npy(file, section, key, image=True) for file in files])
    if suffix in _PICTURES:
        return _joined(files, [_picture(file) for file in files])
    if suffix in ZEISS:
        raise InputError(f"{key}.path: {files[0]}: {NO_ZEISS}")
    raise InputError(
        f"{key}.path: {files[0]}: images with the ending {quoted(suffix)} are not read"
    )


def _files(path: Path, key: str) -> list[Path]:
    if "*" in path.name:
        files = [f for f in path.parent.glob(path.name) if f.is_file()]
    elif path.is_dir():
        files = [f for f in path.iterdir() if f.is_file() and not f.name.startswith(".")]
    elif why := no_file(path):
        raise InputError(f"{key}.path: {path} {why}")
    else:
        return [path]
    if not files:
        raise InputError(f"{key}.path: {path}: no file is there")
    return sorted(files, key=_natural)


def _images_of(path: Path, files: list[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """Return the files of a folder that may be images, and a note on the others, such as reports.

    A file without ending may be a DICOM image. If there are other images, it must begin as one.
    """
    if not path.is_dir():
        return files, ()
    images = [f for f in files if f.suffix.lower() in _IMAGES]
    if any(f.suffix for f in images):
        images = [f for f in images if f.suffix or is_dicom(f)]
    if not images or len(images) == len(files):
        return files, ()
    names = [f.name for f in files if f not in set(images)]
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    listed = ", ".join(names[:MOST_LISTED])
    return images, (f"{path}: skipped files that are no images: {listed}{more}",)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a key that sorts 2 before 10."""
    parts = ((whole_number(part), part) for part in re.split(r"([0-9]{1,18})", path.name))
    return [(-1, text) if number is None else (number, "") for number, text in parts]


def _missing(files: Sequence[Path]) -> tuple[int, ...]:
    """Return the numbers that are missing among those at the end of the names of files."""
    found = [re.findall(r"[0-9]{1,15}", file.stem) for file in files]
    if len(files) < 3 or not all(found):
        return ()
    numbers = [int(one[-1]) for one in found]
    steps = [b - a for a, b in zip(numbers, numbers[1:], strict=False)]
    usual = sorted(steps)[len(steps) // 2]
    # Numbers that are no counts, such as fractions of degrees, have other steps.
    if min(steps) < 1 or any(step % usual for step in steps):
        return ()
    gaps = zip(numbers, steps, strict=False)
    few = [at + usual * i for at, step in gaps for i in range(1, min(step // usual, MOST_GAP))]
    return tuple(few)


def _joined(files: Sequence[Path], stacks: Sequence[Stack]) -> Stack:
    """Return the images of several stacks, one after the other."""
    first, view = stacks[0], 0
    for file, stack in zip(files, stacks, strict=True):
        if (stack.shape, stack.dtype) != (first.shape, first.dtype):
            sizes = (f"{s.shape[0]} x {s.shape[1]} of {s.dtype}" for s in (stack, first))
            raise InputError(
                f"{file}: images of {next(sizes)}, but {files[0]} has {next(sizes)}: image {view} "
                "must have the size and type of the others"
            )
        view += stack.count
    places = [(stack, index) for stack in stacks for index in range(stack.count)]
    where = str(files[0]) if len(files) == 1 else f"{files[0].parent} ({len(files)} files)"

    def image(index: int) -> Image:
        stack, inner = places[index]
        return stack.image(inner)

    return Stack(where, len(places), first.shape, first.dtype, image)


def _of_array(array: Any, section: Files, where: str, **stated: Any) -> Stack:
    """Return the stack in an array of three axes, or of two for a single image."""
    shape, dtype = tuple(array.shape), np.dtype(array.dtype)
    if dtype.kind not in "fiu":
        raise InputError(f"{where} holds {dtype}, not numbers")
    if len(shape) == 2:
        return Stack(where, 1, (shape[0], shape[1]), dtype, lambda index: np.asarray(array[:]))
    if len(shape) != 3 or min(shape) < 1:
        raise InputError(f"{where} has shape {shape}; expected 3 axes: {', '.join(section.axes)}")
    if len(set(section.axes)) != 3:
        raise InputError(f"axes: {', '.join(section.axes)}: name view, row and column once each")
    view, row, column = (section.axes.index(name) for name in ("view", "row", "column"))

    def image(index: int) -> Image:
        at: list[Any] = [slice(None)] * 3
        at[view] = index
        images = np.asarray(array[tuple(at)])
        return images if row < column else images.T

    size = shape[row], shape[column]
    return Stack(where, shape[view], size, dtype, image, exchangeable=True, **stated)


def _npy(path: Path, section: Files, key: str, image: bool = False) -> Stack:
    where = f"{path}"
    file_bytes(path, where)
    with library_errors(where):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    if image and array.ndim != 2:
        raise InputError(f"{where} has shape {array.shape}; expected one image per file")
    return _of_array(array, section, where)


def _npz(path: Path, section: Files, key: str) -> Stack:
    def choose(names: Sequence[str]) -> str:
        return array_name(names, section.array, f"{key}: {path}")

    (array,) = read_npz(path, f"{path}", MOST_BYTES, choose=choose).values()
    return _of_array(array, section, f"{path}")


def _metaimage(path: Path, section: Files, key: str) -> Stack:
    where = f"{path}"
    header = metaimage_header(path, where)
    spacing, offset = (header.numbers(name, 3)[:2] for name in ("ElementSpacing", "Offset"))
    _, array = read_metaimage(path, where)  # (column, row, view)
    stated = {"spacing": tuple(spacing), "first_pixel": tuple(offset)}
    return _of_array(array.transpose(), section, where, **stated)


def _hdf5(path: Path, section: Files, key: str) -> Stack:
    return _of_array(open_hdf5(path, section.array.strip("/"), key), section, f"{path}")


def _raw(files: Sequence[Path], section: Files, key: str) -> Stack:
    try:
        dtype = np.dtype(section.dtype or "V1")
    except TypeError:
        dtype = np.dtype("V1")
    rows, columns = section.rows, section.columns
    if dtype.kind not in "fiu" or not rows or not columns:
        raise InputError(
            f"{key}: raw files need dtype (such as <u2), rows and columns; given are "
            f"{quoted(section.dtype)}, {rows} and {columns}"
        )
    size = rows * columns * dtype.itemsize
    stacks: list[Stack] = []
    for file in files:
        octets = file_bytes(file, str(file)) - section.header_bytes
        if octets <= 0 or octets % size:
            raise InputError(
                f"{file}: {octets} bytes after the header are not a whole number of images of "
                f"{rows} x {columns} pixels of {dtype}, {size} bytes each"
            )

        def image(index: int, file: Path = file) -> Image:
            start = section.header_bytes + index * size
            flat = np.fromfile(file, dtype, rows * columns, offset=start)
            return flat.reshape(rows, columns)

        stacks.append(Stack(str(file), octets // size, (rows, columns), dtype, image))
    return _joined(files, stacks)


def _tiffs(files: Sequence[Path]) -> Iterator[Stack]:
    """Yield the images of TIFF files; of many alike, only the first is read tag by tag."""
    import tifffile

    from twinct.core.files.plain_tiff import plain_tiff

    first = _tiff(files[0])
    yield first
    layout = None
    if len(files) > 1:
        with library_errors(f"{files[0]}"), tifffile.TiffFile(files[0]) as file:
            layout = plain_tiff(file, files[0])
    for path in files[1:]:
        if layout is not None and layout.fits(path):
            image = partial(_plain_image, layout, path)
            yield Stack(str(path), 1, first.shape, first.dtype, image)
        else:
            yield _tiff(path)


def _plain_image(layout: PlainTiff, path: Path, index: int) -> Image:
    with library_errors(f"{path}"):
        return layout.image(path)


def _tiff(path: Path) -> Stack:
    import tifffile

    from twinct.core.files.tiff import page_array

    where = f"{path}"
    file_bytes(path, where)
    with library_errors(where), tifffile.TiffFile(path) as file:
        pages = file.pages
        shape, dtype, count = tuple(pages.first.shape), np.dtype(pages.first.dtype), len(pages)
        for index, page in enumerate(pages):
            if len(page.shape) != 2 or (tuple(page.shape), page.dtype) != (shape, dtype):
                raise InputError(
                    f"{where}: expected grey images of one size and type, but image {index} has "
                    f"shape {tuple(page.shape)} of {page.dtype}, image 0 {shape} of {dtype}"
                )

    def image(index: int) -> Image:
        with library_errors(where), tifffile.TiffFile(path) as file:
            return page_array(file, index, path, where)

    return Stack(where, count, (shape[0], shape[1]), dtype, image)


def _picture(path: Path) -> Stack:
    from twinct.core.files.images import read_image, stated_shape

    shape = stated_shape(path, str(path))
    return Stack(str(path), 1, shape, np.dtype(float), lambda index: read_image(path, "view"))


def _dicom(files: Sequence[Path], section: Files, key: str) -> Stack:
    """Return the images of DICOM files: one or several frames each, by their instance numbers."""
    headers, notes = dicom_files(files, section.series, key)
    stacks = [Stack(str(h.path), h.frames, h.shape, h.dtype, h.image) for h in headers]
    return replace(_joined([header.path for header in headers], stacks), notes=notes)
