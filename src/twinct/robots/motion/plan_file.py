"""Conversion of a motion plan to and from arrays, for files and the scan store."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npz
from twinct.core.files.boundary import library_errors
from twinct.core.files.writing import complete, storage_errors
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.motion.plan import MotionPlan

FORMAT = "twinct plan 1"

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Fixed time stamp of each member of a file, so that equal plans give equal bytes."""

LARGEST_PLAN_BYTES = 2**30
"""Largest total size of the arrays in a file; a plan of 10,000 views has a tenth of this."""


def plan_arrays(plan: MotionPlan) -> dict[str, NDArray[Any]]:
    """Return a plan as named arrays in SI units; poses are x, y, z and quaternion (x, y, z, w)."""
    return {
        "format": np.array(FORMAT),
        "digest": np.array(plan.digest),
        "joint_names": np.array(plan.joint_names),
        "time_s": plan.time_s,
        "state": plan.state,
        "views": plan.views.astype(np.int64),
        "source": np.array([target.source[0].seven for target in plan.targets]),
        "detector": np.array([target.detector[0].seven for target in plan.targets]),
        "clearance_mm": plan.clearance_mm,
        "nearest": np.array(plan.nearest),
    }


def plan_of_arrays(arrays: Mapping[str, Any], where: str) -> MotionPlan:
    """Return the plan that ``plan_arrays`` converted to arrays.

    Args:
        arrays: result of ``plan_arrays``; arrays of texts may be lists.
        where: origin of the arrays, for messages.

    Raises:
        InputError: the arrays form no plan, or not the plan of their digest.
    """
    try:
        if str(arrays["format"]) != FORMAT:
            raise ValueError(f"its format is {arrays['format']}; this twinct reads {FORMAT!r}")
        names = tuple(map(str, arrays["joint_names"]))
        time_s, state = (np.asarray(arrays[name], np.float64) for name in ("time_s", "state"))
        views = np.asarray(arrays["views"]).astype(np.intp)
        sides = [np.asarray(arrays[name], np.float64) for name in ("source", "detector")]
        _require_motion(time_s, state, views, sides, len(names))
        plan = MotionPlan(
            joint_names=names,
            time_s=time_s,
            state=state,
            views=views,
            targets=tuple(
                PosePairs.from_sevens([pair])
                for pair in zip(*(side.tolist() for side in sides), strict=True)
            ),
            clearance_mm=np.asarray(arrays["clearance_mm"], np.float64),
            nearest=tuple((str(a), str(b)) for a, b in arrays["nearest"]),
        )
    except KeyError as error:
        raise InputError(f"{where}: not a valid plan: {error} is missing") from None
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: not a valid plan: {error}") from None
    if plan.digest != str(arrays["digest"]):
        raise InputError(f"{where}: the plan is damaged: it does not match its digest")
    return plan


def _require_motion(
    time_s: Floats, state: Floats, views: NDArray[np.intp], sides: list[Floats], joints: int
) -> None:
    """Check that arrays describe a motion from rest to rest with one exposure of each view.

    Raises:
        ValueError: the shapes disagree, or the values describe no such motion.
    """
    count = len(sides[0])
    shapes = {
        "state": (state.shape, (len(time_s), 3, joints)),
        "views": (views.shape, time_s.shape),
        "source": (sides[0].shape, (count, 7)),
        "detector": (sides[1].shape, (count, 7)),
    }
    for name, (shape, expected) in shapes.items():
        if shape != expected:
            raise ValueError(f"{name} has the shape {shape} instead of {expected}")
    if not all(np.isfinite(values).all() for values in (time_s, state, *sides)):
        raise ValueError("a number is not finite")
    if len(time_s) < 2 or time_s[0] != 0 or (np.diff(time_s) <= 0).any():
        raise ValueError("the times do not increase from 0")
    if not np.array_equal(np.sort(views[views >= 0]), np.arange(count)) or not count:
        raise ValueError("not every view is exposed exactly once")
    if state[[0, -1], 1:].any():
        raise ValueError("the arms are not at rest at both ends")


def save_plan(plan: MotionPlan, path: Path) -> None:
    """Write a plan as a NumPy archive (``.npz``); equal plans give equal bytes.

    Raises:
        StorageError: the file cannot be written.
    """
    with storage_errors(path), complete(path) as draft:
        with zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, values in plan_arrays(plan).items():
                member = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
                member.compress_type = zipfile.ZIP_DEFLATED
                with archive.open(member, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, values, allow_pickle=False)


def load_plan(path: Path) -> MotionPlan:
    """Read a plan that ``save_plan`` wrote, without checking it against a cell.

    Raises:
        InputError: the file holds no plan, or is damaged.
    """
    arrays = read_npz(path, f"{path}: the plan file", LARGEST_PLAN_BYTES)
    with library_errors(f"{path}: the plan file"):  # arrays of any kind and shape
        return plan_of_arrays(arrays, str(path))
