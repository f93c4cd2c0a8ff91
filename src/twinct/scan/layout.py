"""Layout of a store on disk: arrays, chunks, and everything except the views."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.interruption import postponed
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.scan.data import bad_pixels_of
from twinct.scan.manifest import BY_VIEW, chunk_name, write_frame_manifest
from twinct.scan.metadata import BAD_PIXELS, EXPOSURE, MAS, chunk_shape
from twinct.scenario import Scenario, stage_digests

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

FORMAT = 5
"""Format of stores without joints: their arrays of size 0 have chunks of size 1, not 0."""
WITH_MANIFEST = 4
"""First format with a manifest. Stores with joints keep it, so that older versions read them."""
READABLE = (1, 2, 3, WITH_MANIFEST, FORMAT)


def image_digests(scenario: Scenario) -> dict[str, str]:
    """Return the digests of the stages that a store's images depend on."""
    return {"images": stage_digests(scenario)["images"]}


def pose_columns(which: str, source: Pose, detector: Pose) -> dict[str, Any]:
    """Return the stored values of one view's commanded or executed poses."""
    axes = detector.rotation
    return {
        f"{which}/source": source.position,
        f"{which}/detector": detector.position,
        f"{which}/u": axes[:, 0],
        f"{which}/v": axes[:, 1],
        f"{which}/source_quat": source.quat,
        f"{which}/detector_quat": detector.quat,
    }


def columns_of(reached: Reached) -> dict[str, Any]:
    """Return the stored values of a view, except its images."""
    executed = reached.executed
    columns = pose_columns("executed", *executed[0])
    if reached.exposure:
        columns[EXPOSURE] = reached.exposure.sevens
    return columns | {
        "executed/object": executed.object[0].position,
        "executed/object_quat": executed.object[0].quat,
        "joints": reached.position,
        "joint_velocity": reached.velocity,
        "joint_torque": reached.effort,
        "state": reached.state,
        "simulated_s": reached.time_s,
        "clearance_mm": reached.clearance_mm,
    }


def _write_plan(root: Any, plan: MotionPlan) -> None:
    """Write a plan: numbers as arrays, texts as attributes of the group."""
    from zarr.codecs import BloscCodec

    from twinct.robots.motion import plan_arrays

    group = root.create_group("plan")
    for name, values in plan_arrays(plan).items():
        if values.dtype.kind == "U":
            group.attrs[name] = values.tolist()
        else:
            whole = BloscCodec(cname="lz4", shuffle="shuffle")
            group.create_array(name, data=values, chunks=values.shape, compressors=whole)


def _attributes(
    scenario: Scenario, joint_names: tuple[str, ...], digests: dict[str, str] | None
) -> dict[str, Any]:
    panel = scenario.detector.panel
    return {
        "format": WITH_MANIFEST if joint_names else FORMAT,
        "digests": digests or image_digests(scenario),
        "scenario": scenario.resolved(),
        "pixel_pitch_mm": [panel.pitch_u, panel.pitch_v],
        "joint_names": list(joint_names),
    }


@postponed()
def write_frame(
    path: Path,
    scenario: Scenario,
    commanded: PosePairs,
    joint_names: tuple[str, ...],
    state_size: int,
    plan: MotionPlan | None,
    digests: dict[str, str] | None = None,
    mas: NDArray[np.float64] | None = None,
) -> None:
    """Write a store without views; ``digests`` default to digests of the current files."""
    import zarr as _zarr
    from zarr.codecs import BloscCodec

    zarr: Any = _zarr  # typed in part only
    views, panel = len(commanded), scenario.detector.panel
    group: Any = zarr.create_group(str(path), zarr_format=3)
    group.attrs.update(_attributes(scenario, joint_names, digests))
    last: list[str] = []

    def add(name: str, shape: tuple[int, ...], dtype: str = "f8", compressed: bool = False) -> None:
        last.append(f"{name}/{chunk_name(views - 1, len(shape))}")
        group.create_array(
            name,
            shape=(views, *shape),
            chunks=(1, *chunk_shape(shape)),
            dtype=dtype,
            fill_value=0 if dtype == "u1" else np.nan,
            compressors=BloscCodec(cname="lz4", shuffle="shuffle") if compressed else None,
            chunk_key_encoding=BY_VIEW,
        )

    for name in dict.fromkeys(("transmission", *scenario.detector.keep)):
        add(name, panel.shape, "f4", compressed=True)
    rows = [pose_columns("commanded", *commanded[view]) for view in range(views)]
    for name, value in rows[0].items():
        add(name.replace("commanded", "executed"), value.shape)
        group.create_array(name, data=np.array([row[name] for row in rows]), compressors=None)
    add("executed/object", (3,))
    add("executed/object_quat", (4,))
    if scenario.source.motion_samples > 1:
        add(EXPOSURE, (scenario.source.motion_samples, 3, 7))
    for name in ("joints", "joint_velocity", "joint_torque"):
        add(name, (len(joint_names),))
    add("state", (state_size,))
    for name in ("simulated_s", "clearance_mm"):
        add(name, ())
    of_a_view = tuple(last)
    for name, values in ((BAD_PIXELS, bad_pixels_of(scenario)), (MAS, mas)):
        if values is not None:
            group.create_array(name, data=values, chunks=values.shape, compressors=None)
    add("status", (), "u1")
    if plan is not None:
        _write_plan(group, plan)
    write_frame_manifest(group, path, of_a_view, views)
