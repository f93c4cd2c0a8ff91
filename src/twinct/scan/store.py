"""The scan store: a Zarr group with one chunk a view, so that no acquired view is ever lost.

A view's status is written last; what lies about of a view without status comes from a killed write
and is removed on resume. The store holds no clock times: the same scenario gives the same bytes.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import zarr as _zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec

from twinct.errors import InputError, ScanExistsError
from twinct.files.writing import require_space, storage_errors
from twinct.geometry import Pose
from twinct.scan.data import Scan, View, reported
from twinct.scenario import Scenario, parse_scenario, stage_digests
from twinct.views import Instant, PosePairs

if TYPE_CHECKING:
    from twinct.motion import MotionPlan

zarr: Any = _zarr
"""Typed in part only."""

FORMAT = 3
READABLE = (1, 2, FORMAT)
ACQUIRED = 1
EXPOSURE = "executed/exposure"
"""Present where an exposure has several instants."""


def check_space(folder: Path, scenario: Scenario, views: int) -> None:
    """Refuse to start what the disk cannot hold.

    Raises:
        StorageError: with the bytes needed and the bytes free.
    """
    grid = scenario.reconstruction.grid.volume_grid
    images = views * scenario.detector.rows * scenario.detector.columns * 4
    volumes = 2 * int(np.prod(grid.shape)) * 4
    require_space(folder, images + volumes, "the scan and its volume need")


class ScanStore:
    """One scan on disk."""

    def __init__(self, path: Path) -> None:
        """Open an existing store; ``create`` and ``resume`` make one that can be written.

        Raises:
            InputError: its format is not known.
        """
        self.path = path
        self._group: Any = zarr.open_group(str(path), mode="r+")
        self._format = self._group.attrs.get("format")
        if self._format not in READABLE:
            raise InputError(
                f"{path}: a scan store of format {self._format!r}; this twinct reads "
                f"{' and '.join(map(str, READABLE))}: a newer one may read it"
            )
        self._arrays: dict[str, Any] = {}

    @classmethod
    def create(
        cls,
        path: Path,
        scenario: Scenario,
        commanded: PosePairs,
        joint_names: tuple[str, ...],
        state_size: int,
        plan: MotionPlan | None = None,
    ) -> ScanStore:
        """Make a store without views; it appears under its name only when it is complete.

        A plan is kept where the arms follow one.

        Raises:
            ScanExistsError: there is one already.
            StorageError: it cannot be written.
        """
        if path.exists():
            raise ScanExistsError(f"{path} already holds a scan: choose another --out or --resume")
        draft = path.with_name(path.name + ".new")
        with storage_errors(path):
            shutil.rmtree(draft, ignore_errors=True)
            path.parent.mkdir(parents=True, exist_ok=True)
            _write_frame(draft, scenario, commanded, joint_names, state_size)
            if plan is not None:
                _write_plan(draft, plan)
            draft.rename(path)
        return cls(path)

    @classmethod
    def resume(cls, path: Path, scenario: Scenario) -> ScanStore:
        """Open a store to go on where it ended, after removing what a killed write left.

        Raises:
            ScanExistsError: it holds the scan of another scenario.
        """
        store = cls(path)
        store.refuse_other(scenario)
        with storage_errors(path):
            store._remove_unfinished()
        return store

    def refuse_other(self, scenario: Scenario) -> None:
        """Make sure that this is the scan of a scenario.

        Raises:
            ScanExistsError: it is another one's.
        """
        own, other = self.digests, _kept_digests(scenario)
        differ = [
            f"{name} {own.get(name, 'none')[:12]}, this one has {digest[:12]}"
            for name, digest in other.items()
            if own.get(name) != digest
        ]
        if differ:
            raise ScanExistsError(
                f"{self.path} holds the scan of another scenario (digest of its {'; '.join(differ)}"
                "): choose another --out"
            )

    @property
    def acquired(self) -> int:
        """Number of views on disk; views are taken in order."""
        status = np.asarray(self._array("status")[:])
        done = status == ACQUIRED
        return int(len(done) if done.all() else done.argmin())

    @property
    def views(self) -> int:
        """Number of views the scan shall have."""
        return self._array("status").shape[0]

    @property
    def scenario(self) -> Scenario:
        """The scenario the scan was taken with."""
        told = json.loads(str(self._group.attrs["scenario"]))
        if "plan" not in self._group:  # nor was there a scheme, before there were plans
            told["motion"].setdefault("scheme", "reactive")
        return parse_scenario(told)

    @property
    def digests(self) -> dict[str, str]:
        """Digest of the images: of their scenario, and its files as they were.

        Format 1 had another: it is made from the scenario that the store holds, and of its files
        as they are now, so that a file changed since the scan is not noticed. Format 2 had one of
        the believed poses besides, which were part of the store.
        """
        if self._format == 1:
            return _kept_digests(self.scenario)
        return cast("dict[str, str]", self._group.attrs["digests"])

    @property
    def digest_0_1(self) -> str | None:
        """What version 0.1 knew the scan by; None of a later one."""
        return str(self._group.attrs["digest"]) if self._format == 1 else None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, source arm first."""
        return tuple(self._group.attrs["joint_names"])

    @property
    def plan(self) -> MotionPlan | None:
        """The plan that the arms follow; None where each target is solved as it comes.

        Raises:
            InputError: it is damaged.
        """
        if "plan" not in self._group:
            return None
        from twinct.motion import plan_of_arrays

        group = self._group["plan"]
        arrays = {name: np.asarray(array[:]) for name, array in group.arrays()}
        return plan_of_arrays({**arrays, **group.attrs}, f"{self.path}/plan")

    def state(self, view: int) -> NDArray[np.float64]:
        """The full simulator state of a view."""
        return np.asarray(self._array("state")[view])

    def transmission(self, view: int) -> NDArray[np.float32]:
        """I/I0 of a view, (rows, columns)."""
        return np.asarray(self._array("transmission")[view])

    def write(self, index: int, view: View) -> None:
        """Put one view on disk; it counts once its status is written.

        Raises:
            StorageError: the disk is full. What was written before stays good.
            ValueError: something of the view has another shape than the scan; nothing is written.
        """
        columns = _columns(view)
        if self._format < FORMAT:  # begun by an older twinct, which did not keep them
            del columns["joint_velocity"], columns["joint_torque"]
        for name, values in {"transmission": view.transmission, **columns}.items():
            if np.shape(values) != (shape := self._array(name).shape[1:]):
                raise ValueError(f"{name} of view {index} has {np.shape(values)}, the scan {shape}")
        with storage_errors(self.path):
            self._array("transmission")[index] = view.transmission
            for name, values in columns.items():
                self._put(name, index, np.asarray(values, dtype="<f8"))
            self._finish(index)

    def read(self) -> Scan:
        """The scan, images included.

        Raises:
            ScanExistsError: not all views were acquired yet.
        """
        if self.acquired < self.views:
            raise ScanExistsError(
                f"{self.path} holds {self.acquired} of {self.views} views: "
                "finish it with 'twinct run --resume'"
            )
        exposure: Any = self._array(EXPOSURE)[:].tolist() if EXPOSURE in self._group else []
        return Scan(
            scenario=self.scenario,
            transmission=self._array("transmission")[:],
            commanded=self.poses("commanded"),
            executed=self.poses("executed"),
            executed_object=self._poses("executed/object", self.views),
            joint_names=self.joint_names,
            joints=self._array("joints")[:],
            simulated_s=self._array("simulated_s")[:],
            clearance_mm=self._array("clearance_mm")[:],
            exposure=tuple(tuple(Instant(*map(tuple, at)) for at in view) for view in exposure),
        )

    def _put(self, name: str, index: int, values: NDArray[Any]) -> None:
        """Write one uncompressed chunk: its bytes are the values, as the Zarr 3 format says.

        Through Zarr itself each of the twenty small chunks of a view takes 1 to 2 ms.
        """
        with open(f"{self.path}/{name}/{_chunk(index, values.ndim)}", "wb", buffering=0) as file:
            file.write(values.tobytes())

    def _finish(self, index: int) -> None:
        """Write the status of a view, whole or not at all."""
        chunk = self.path / "status" / _chunk(index, 0)
        draft = chunk.with_name(chunk.name + ".partial")
        draft.write_bytes(bytes([ACQUIRED]))
        draft.replace(chunk)

    def poses(self, which: str) -> PosePairs:
        """``commanded``, ``executed`` or ``believed`` poses of the views on disk."""
        views = self.acquired
        if which == "believed":
            joints = np.asarray(self._array("joints")[:views])
            return reported(self.scenario, self.joint_names, joints, self.poses("executed")).poses
        pairs = (self._poses(f"{which}/{body}", views) for body in ("source", "detector"))
        return PosePairs(*pairs)

    def _poses(self, name: str, views: int) -> tuple[Pose, ...]:
        columns = self._array(name)[:views], self._array(f"{name}_quat")[:views]
        return tuple(map(Pose, *columns))

    def _array(self, name: str) -> Any:
        if name not in self._arrays:
            self._arrays[name] = self._group[name]
        return self._arrays[name]

    def _remove_unfinished(self) -> None:
        """Delete chunks of views that have no status, and temporary files."""
        first = self.acquired
        for file in self.path.rglob("*"):
            if not file.is_file():
                continue
            mark, _, view = file.name.partition(".")
            unfinished = mark == "c" and "commanded" not in file.parts[len(self.path.parts) :]
            if unfinished and int(view.split(".")[0]) >= first or file.suffix == ".partial":
                file.unlink()


def _kept_digests(scenario: Scenario) -> dict[str, str]:
    return {"images": stage_digests(scenario)["images"]}


def _chunk(index: int, dimensions: int) -> str:
    """Name of a view's chunk. Without a folder of its own it takes a quarter of the time."""
    return ".".join(["c", str(index), *["0"] * dimensions])


def _pose_columns(which: str, source: Pose, detector: Pose) -> dict[str, Any]:
    """What is stored of one view's commanded or executed poses."""
    axes = detector.rotation
    return {
        f"{which}/source": source.position,
        f"{which}/detector": detector.position,
        f"{which}/u": axes[:, 0],
        f"{which}/v": axes[:, 1],
        f"{which}/source_quat": source.quat,
        f"{which}/detector_quat": detector.quat,
    }


def _columns(view: View) -> dict[str, Any]:
    reached, executed = view.reached, view.reached.executed
    columns = _pose_columns("executed", executed.source, executed.detector)
    if reached.exposure:
        columns[EXPOSURE] = reached.exposure
    return columns | {
        "executed/object": executed.object.position,
        "executed/object_quat": executed.object.quat,
        "joints": reached.position,
        "joint_velocity": reached.velocity,
        "joint_torque": reached.effort,
        "state": reached.state,
        "simulated_s": reached.time_s,
        "clearance_mm": reached.clearance_mm,
    }


def _write_plan(path: Path, plan: MotionPlan) -> None:
    """Numbers as arrays, words as attributes of their group."""
    from twinct.motion import plan_arrays

    group: Any = zarr.open_group(str(path), mode="r+").create_group("plan")
    for name, values in plan_arrays(plan).items():
        if values.dtype.kind == "U":
            group.attrs[name] = values.tolist()
        else:
            whole = BloscCodec(cname="lz4", shuffle="shuffle")
            group.create_array(name, data=values, chunks=values.shape, compressors=whole)


def _write_frame(
    path: Path,
    scenario: Scenario,
    commanded: PosePairs,
    joint_names: tuple[str, ...],
    state_size: int,
) -> None:
    views, panel = len(commanded), scenario.detector.panel
    group: Any = zarr.create_group(str(path), zarr_format=3)
    attributes = {
        "format": FORMAT,
        "digests": _kept_digests(scenario),
        "scenario": scenario.resolved(),
        "pixel_pitch_mm": [panel.pitch_u, panel.pitch_v],
        "joint_names": list(joint_names),
    }
    group.attrs.update(attributes)

    def add(name: str, shape: tuple[int, ...], dtype: str = "f8", compressed: bool = False) -> None:
        group.create_array(
            name,
            shape=(views, *shape),
            chunks=(1, *shape),
            dtype=dtype,
            fill_value=0 if dtype == "u1" else np.nan,
            compressors=BloscCodec(cname="lz4", shuffle="shuffle") if compressed else None,
            chunk_key_encoding={"name": "default", "separator": "."},
        )

    add("transmission", panel.shape, "f4", compressed=True)
    rows = [_pose_columns("commanded", *commanded[view]) for view in range(views)]
    for name, value in rows[0].items():
        add(name.replace("commanded", "executed"), value.shape)
        column = np.array([row[name] for row in rows])
        group.create_array(name, data=column, compressors=None)
    add("executed/object", (3,))
    add("executed/object_quat", (4,))
    if scenario.source.motion_samples > 1:
        add(EXPOSURE, (scenario.source.motion_samples, 3, 7))
    for name in ("joints", "joint_velocity", "joint_torque"):
        add(name, (len(joint_names),))
    add("state", (state_size,))
    add("simulated_s", ())
    add("clearance_mm", ())
    add("status", (), "u1")
