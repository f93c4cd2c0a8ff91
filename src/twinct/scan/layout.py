"""Layout of a store on disk: arrays, chunks, and everything except the views."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.interruption import postponed
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.scan.data import bad_pixels_of
from twinct.scan.manifest import BY_VIEW, chunk_name, write_frame_manifest
from twinct.scan.metadata import BAD_PIXELS, EXPOSURE, IMPORTED, MAS, chunk_shape
from twinct.scan.provenance import Imported
from twinct.scenario import Scenario, stage_digests
from twinct.scenario.imported import STATED

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

FORMAT = 5
"""Format of stores without joints: their arrays of size 0 have chunks of size 1, not 0."""
WITH_MANIFEST = 4
"""First format with a manifest. Stores with joints keep it, so that older versions read them."""
READABLE = (1, 2, 3, WITH_MANIFEST, FORMAT, IMPORTED)


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


@dataclass
class _Frame:
    """Store without views that is being written."""

    group: Any
    views: int
    of_a_view: list[str] = field(default_factory=list[str])

    def add(
        self, name: str, shape: tuple[int, ...], dtype: str = "f8", *, compressed: bool = False
    ) -> None:
        """Add an array with one chunk for each view."""
        from zarr.codecs import BloscCodec

        if name != "status":
            self.of_a_view.append(f"{name}/{chunk_name(self.views - 1, len(shape))}")
        self.group.create_array(
            name,
            shape=(self.views, *shape),
            chunks=(1, *chunk_shape(shape)),
            dtype=dtype,
            fill_value=0 if dtype == "u1" else np.nan,
            compressors=BloscCodec(cname="lz4", shuffle="shuffle") if compressed else None,
            chunk_key_encoding=BY_VIEW,
        )

    def put(self, **arrays: NDArray[Any] | None) -> None:
        """Write whole arrays in one chunk each, as far as there are any."""
        for name, values in arrays.items():
            if values is not None:
                self.group.create_array(name, data=values, chunks=values.shape, compressors=None)

    def put_poses(self, which: str, poses: PosePairs) -> list[tuple[str, tuple[int, ...]]]:
        """Write the poses of all views; return name and shape of each array of a view."""
        rows = [pose_columns(which, *poses[view]) for view in range(self.views)]
        for name in rows[0]:
            data = np.array([row[name] for row in rows])
            self.group.create_array(name, data=data, compressors=None)
        return [(name, value.shape) for name, value in rows[0].items()]


def _frame(path: Path, views: int, attributes: dict[str, Any]) -> _Frame:
    import zarr as _zarr

    zarr: Any = _zarr  # typed in part only
    group: Any = zarr.create_group(str(path), zarr_format=3)
    group.attrs.update(attributes)
    return _Frame(group, views)


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
    files: tuple[str, ...] = (),
) -> None:
    """Write the store of a scenario's scan without views.

    ``digests`` default to digests of the current files. ``files``: recordings of real arms.
    """
    panel = scenario.detector.panel
    attributes = {
        "format": WITH_MANIFEST if joint_names else FORMAT,
        "digests": digests or image_digests(scenario),
        "scenario": scenario.resolved(),
        "pixel_pitch_mm": [panel.pitch_u, panel.pitch_v],
        "joint_names": list(joint_names),
        **({"recorded": list(files)} if files else {}),
    }
    frame = _frame(path, len(commanded), attributes)
    for name in dict.fromkeys(("transmission", *scenario.detector.keep)):
        frame.add(name, panel.shape, "f4", compressed=True)
    for name, shape in frame.put_poses("commanded", commanded):
        frame.add(name.replace("commanded", "executed"), shape)
    frame.add("executed/object", (3,))
    frame.add("executed/object_quat", (4,))
    if scenario.source.motion_samples > 1:
        frame.add(EXPOSURE, (scenario.source.motion_samples, 3, 7))
    for name in ("joints", "joint_velocity", "joint_torque"):
        frame.add(name, (len(joint_names),))
    frame.add("state", (state_size,))
    for name in ("simulated_s", "clearance_mm"):
        frame.add(name, ())
    frame.put(**{BAD_PIXELS: bad_pixels_of(scenario.detector, scenario.seed), MAS: mas})
    frame.add("status", (), "u1")
    if plan is not None:
        _write_plan(frame.group, plan)
    write_frame_manifest(frame.group, path, frame.of_a_view, frame.views)


@postponed()
def write_imported_frame(
    path: Path, provenance: Imported, bad_pixels: NDArray[np.bool_] | None
) -> None:
    """Write the store of an imported scan without views."""
    settings = provenance.settings
    panel = settings.detector.panel
    attributes = {
        "format": IMPORTED,
        "settings": settings.resolved(),
        "files": list(provenance.files),
        "pixel_pitch_mm": [panel.pitch_u, panel.pitch_v],
    }
    frame = _frame(path, len(provenance.stated), attributes)
    frame.add("transmission", panel.shape, "f4", compressed=True)
    frame.put_poses(STATED, provenance.stated)
    frame.put(**{BAD_PIXELS: bad_pixels})
    frame.add("status", (), "u1")
    write_frame_manifest(frame.group, path, frame.of_a_view, frame.views)
