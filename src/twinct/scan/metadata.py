"""Checks of a scan store's metadata before use.

The manifest shows whether files have changed since they were written. These checks show whether
the content can be a scan at all, even if the manifest is missing or was made anew.
"""

from __future__ import annotations

import errno
import json
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from twinct.core.errors import InputError
from twinct.core.files.plain_json import json_of
from twinct.scenario.imported import STATED

EXPOSURE = "executed/exposure"
"""Present if an exposure has several instants."""
BAD_PIXELS = "bad_pixels"
"""Present if the detector has bad pixels."""
MAS = "mas"
"""Present if the trajectory sets the tube load of each view."""
FRAMES = ("raw", "flat", "dark")
"""Images that a scan may store in addition to the transmission."""

_POSES = {"source": 3, "detector": 3, "u": 3, "v": 3, "source_quat": 4, "detector_quat": 4}
_OBJECT = {"executed/object": 3, "executed/object_quat": 4}
_JOINTS = ("joints", "joint_velocity", "joint_torque")
_ARRAYS = (
    *("status", "transmission", *FRAMES, BAD_PIXELS, MAS, EXPOSURE, *_OBJECT, *_JOINTS),
    *("state", "simulated_s", "clearance_mm"),
    *(f"{which}/{name}" for which in ("commanded", "executed", STATED) for name in _POSES),
)

IMPORTED = 6
"""First format of imported scans: their settings and stated poses, in place of a scenario."""

NO_FILE_OF_IT = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG)
"""Errors for a path that holds no array; with thousands of dimensions its name is too long."""


@contextmanager
def readable(path: Path, what: str) -> Generator[None]:
    """Turn any error of Zarr and its codecs about a store's content into one message.

    Raises:
        InputError: the content is unreadable; the message names the store and ``what``.
    """
    try:
        yield
    except InputError:
        raise
    except (
        *(ValueError, TypeError, LookupError, RuntimeError, ArithmeticError),
        MemoryError,  # from false sizes in the metadata
    ) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(f"{path}: {what} cannot be read: {reason}") from error
    except OSError as error:
        if error.errno not in NO_FILE_OF_IT:
            raise
        raise InputError(f"{path}: {what} cannot be read: {error.strerror}") from error


def check_attributes(path: Path, data: Any) -> None:
    """Check the attributes of a store whose format is known.

    Raises:
        InputError: attributes are missing or have the wrong type; one sentence for each.
    """
    wanted: dict[str, Any] = {"scenario": str, "joint_names": list}
    wanted |= {"digest": str} if data["format"] == 1 else {"digests": dict}
    if data["format"] >= IMPORTED:
        wanted = {"settings": str, "files": list}
    problems = [
        f"{path}/zarr.json: attributes.{key}: {_kind(data.get(key))}, expected {_NAMES[kind]}"
        for key, kind in wanted.items()
        if not isinstance(data.get(key), kind)
    ]
    if not problems:
        lists = (data.get(key) or () for key in ("joint_names", "files", "recorded"))
        texts: list[Any] = [*chain(*lists), *(data.get("digests") or {}).values()]
        if not all(isinstance(text, str) for text in texts):
            problems.append(f"{path}/zarr.json: attributes: names and digests must be strings")
        key = next(iter(wanted))
        try:
            if not isinstance(json_of(data[key]), dict):
                raise ValueError("it does not map keys to values")
        except ValueError as error:
            problems.append(f"{path}/zarr.json: attributes.{key}: not a JSON mapping: {error}")
    if problems:
        raise InputError(problems)


_NAMES = {str: "a string", list: "a list", dict: "a mapping"}


def _kind(value: Any) -> str:
    return "missing" if value is None else type(value).__name__


def check_arrays(path: Path, group: Any) -> None:
    """Check presence, shape and type of the arrays in a store whose attributes are valid.

    Raises:
        InputError: arrays do not fit; one sentence for each.
    """
    import zarr

    with readable(path, "the metadata of an array"):
        arrays = {name: group[name] for name in _ARRAYS if name in group}
    if groups := [name for name, array in arrays.items() if not isinstance(array, zarr.Array)]:
        raise InputError(f"{path}/{groups[0]}: found a group, expected an array")
    status, image = arrays.get("status"), arrays.get("transmission")
    if status is None or image is None or len(status.shape) != 1 or len(image.shape) != 3:
        raise InputError(
            f"{path}: statuses (views) or images (views, rows, columns) are missing, or have the "
            "wrong number of axes"
        )
    views, joints = status.shape[0], len(group.attrs.get("joint_names", ()))
    problems = [
        f"{path}/{name}: missing"
        if name not in arrays
        else f"{path}/{name}: {arrays[name].dtype} of {arrays[name].shape}, expected {dtype} of "
        f"{(views, *shape)}"
        for name, (shape, dtype, by_view) in _expected(group.attrs["format"], image, arrays).items()
        if name not in arrays or not _fits(arrays[name], (views, *shape), dtype, by_view=by_view)
    ]
    problems += [
        f"{path}/{name}: shape {arrays[name].shape[1:]} per view, but there are {joints} joints"
        for name in _JOINTS
        if name in arrays and arrays[name].shape[1:] != (joints,)
    ]
    if BAD_PIXELS in arrays and not _fits(arrays[BAD_PIXELS], image.shape[1:], np.bool_):
        problems.append(f"{path}/{BAD_PIXELS}: expected one truth value per pixel")
    if MAS in arrays and not _fits(arrays[MAS], (views,), np.float64):
        problems.append(f"{path}/{MAS}: expected one number per view")
    if problems:
        raise InputError(problems)


def _expected(
    format_: int, image: Any, arrays: dict[str, Any]
) -> dict[str, tuple[tuple[int, ...], DTypeLike, bool]]:
    """Return by array: shape of a view, type, and True for arrays with one chunk per view."""

    def like(name: str) -> tuple[int, ...]:
        return arrays[name].shape[1:] if name in arrays and len(arrays[name].shape) == 2 else (0,)

    every: dict[str, tuple[tuple[int, ...], DTypeLike, bool]] = {"status": ((), np.uint8, True)}
    images = ("transmission", *(name for name in FRAMES if name in arrays))
    every |= {name: (image.shape[1:], np.float32, True) for name in images}
    if format_ >= IMPORTED:
        return every | {f"{STATED}/{name}": ((n,), np.float64, False) for name, n in _POSES.items()}
    numbers: dict[str, tuple[int, ...]] = {f"executed/{k}": (n,) for k, n in _POSES.items()}
    numbers |= {name: (n,) for name, n in _OBJECT.items()} | {"state": like("state")}
    numbers |= {"joints": like("joints"), "simulated_s": (), "clearance_mm": ()}
    if format_ >= 3:
        numbers |= {name: like(name) for name in _JOINTS[1:]}
    if EXPOSURE in arrays:
        numbers[EXPOSURE] = (*arrays[EXPOSURE].shape[1:2], 3, 7)
    return {
        **every,
        **{name: (shape, np.float64, True) for name, shape in numbers.items()},
        **{f"commanded/{name}": ((n,), np.float64, False) for name, n in _POSES.items()},
    }


def chunk_shape(shape: Iterable[int]) -> tuple[int, ...]:
    """Return the shape of the one chunk that holds values of a shape.

    A scan without arms has values of no joints. Zarr 3 asks for chunks of at least 1 along each
    axis (https://zarr-specs.readthedocs.io/en/latest/v3/chunk-grids/regular-grid), and Zarr-Python
    from 3.2 on refuses others.
    """
    return tuple(max(1, size) for size in shape)


def with_legal_chunks(metadata: bytes) -> bytes:
    """Return the metadata of an array or group with chunks as ``chunk_shape`` makes them.

    Up to format 4, arrays of size 0 had chunks of size 0. They hold no values, so that the size of
    their chunks means nothing.
    """
    if b"chunk_shape" not in metadata:
        return metadata
    try:
        data = json_of(metadata)
        grid = data["chunk_grid"]["configuration"]
        grid["chunk_shape"] = [
            1 if size == chunk == 0 else chunk
            for size, chunk in zip(data["shape"], grid["chunk_shape"], strict=True)
        ]
    except (ValueError, TypeError, LookupError):
        return metadata  # Zarr names the error
    return json.dumps(data).encode()


def _fits(array: Any, shape: tuple[int, ...], dtype: DTypeLike, *, by_view: bool = False) -> bool:
    chunks = (1, *chunk_shape(shape[1:])) if by_view else array.chunks
    return array.shape == shape and array.dtype == dtype and array.chunks == chunks
