"""The scan store: a Zarr group with one chunk per view, so that no acquired view is ever lost.

A view's status is written last. Files of a view without status come from a killed write, and are
removed on resume. The store holds no clock times: the same scenario gives the same bytes.
"""

from __future__ import annotations

import errno
import logging
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import DamagedError, InputError, ScanExistsError
from twinct.core.files.plain_json import json_of
from twinct.core.files.writing import complete, require_space, storage_errors
from twinct.core.files.zarr_chunks import ZarrChunks
from twinct.core.foreign_text import quoted
from twinct.core.interruption import postponed
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.scan.damage import clear_paths, frame_damage, view_damage
from twinct.scan.data import Scan, bad_pixels_of
from twinct.scan.layout import (
    READABLE,
    WITH_MANIFEST,
    columns_of,
    image_digests,
    write_frame,
    write_imported_frame,
)
from twinct.scan.manifest import (
    FOLDER,
    FRAME_FILE,
    Damage,
    chunk_name,
    damaged,
    digest_of,
    read_row,
    view_of,
)
from twinct.scan.metadata import (
    BAD_PIXELS,
    EXPOSURE,
    FRAMES,
    IMPORTED,
    MAS,
    check_arrays,
    check_attributes,
    readable,
)
from twinct.scan.named_geometries import NamedGeometry
from twinct.scan.provenance import Imported, Provenance, Recorded, Simulated, scenario_in
from twinct.scan.status import is_acquired, mark_acquired, status_file, views_taken
from twinct.scan.sweeps import SWEEPS, Sweeps, read_sweeps, sweeps_damage, write_sweeps
from twinct.scenario import Scenario, parse_scenario
from twinct.scenario.imported import (
    STATED,
    ImportedSettings,
    ScanSettings,
    is_imported,
    load_imported,
)

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.xray.chain import ViewImages

log = logging.getLogger(__name__)


def check_space(folder: Path, settings: ScanSettings, views: int) -> None:
    """Check that the disk can hold the scan and its volume.

    Raises:
        StorageError: space is short; the message states the bytes needed and free.
    """
    grid, detector = settings.reconstruction.volume_grid, settings.detector
    images = (1 + len(detector.keep)) * views * detector.rows * detector.columns * 4
    volumes = 3 * int(np.prod(grid.shape)) * 4
    require_space(folder, images + volumes, "the scan and its volume need")


class Readings(NamedTuple):
    """Stored poses of consecutive views of a scan, and state of the robots if there are any.

    Attributes:
        taken: poses of source and panel at exposure, as far as known.
        objects: ``world_from_object``; empty if it is not known.
        joints: rad, (views, joints).
        simulated_s: simulated time at exposure, (views,), or empty.
        clearance_mm: smallest gap on the way to each view, (views,), or empty.
    """

    taken: PosePairs
    objects: tuple[Pose, ...]
    joints: NDArray[np.float64]
    simulated_s: NDArray[np.float64]
    clearance_mm: NDArray[np.float64]


class ScanStore:
    """One scan on disk."""

    def __init__(self, path: Path) -> None:
        """Open an existing store; to write views, use ``create`` or ``resume``.

        Raises:
            FileNotFoundError: the store does not exist.
            DamagedError: a file that belongs to no single view is damaged.
            InputError: the format is unknown, or the metadata describe no valid scan.
        """
        import zarr as _zarr

        from twinct.scan.checked import CheckedStore

        zarr: Any = _zarr  # typed in part only
        self.path = path
        if not path.is_dir():
            raise FileNotFoundError(errno.ENOENT, "no scan store", str(path))
        if damages := frame_damage(path):
            raise damaged(path, *damages)
        with readable(path, "its metadata"):
            self._files = CheckedStore(path)
            self._group: Any = zarr.open_group(self._files, mode="r+")
            self._format = self._group.attrs.get("format")
        if isinstance(self._format, bool) or self._format not in READABLE:
            raise InputError(
                f"{path}: the scan store has format {quoted(self._format)}; this twinct reads "
                f"{' and '.join(map(str, READABLE))}; a newer one may read it"
            )
        if self._format >= WITH_MANIFEST and not self.vouched:
            raise damaged(path, Damage(FRAME_FILE, "missing"))
        check_attributes(path, self._group.attrs)
        check_arrays(path, self._group)
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
        digests: dict[str, str] | None = None,
        mas: NDArray[np.float64] | None = None,
        recordings: tuple[str, ...] = (),
    ) -> ScanStore:
        """Create a store without views, which appears under its name only when it is complete.

        ``plan``: for arms that follow one. ``digests``: by default computed from this scenario and
        its current files. ``mas``: tube load of each view, if it varies. ``recordings``: files of
        real arms, if they took the scan.

        Raises:
            ScanExistsError: the path already exists.
            StorageError: the store cannot be written.
        """
        of_views = commanded, joint_names, state_size, plan, digests, mas, recordings
        return cls._new(path, lambda draft: write_frame(draft, scenario, *of_views))

    @classmethod
    def create_imported(
        cls, path: Path, provenance: Imported, bad_pixels: NDArray[np.bool_] | None
    ) -> ScanStore:
        """Create the store of an imported scan, without views.

        Raises:
            ScanExistsError: the path already exists.
            StorageError: the store cannot be written.
        """
        return cls._new(path, lambda draft: write_imported_frame(draft, provenance, bad_pixels))

    @classmethod
    def _new(cls, path: Path, write: Callable[[Path], None]) -> ScanStore:
        if path.exists():
            raise ScanExistsError(f"{path} already holds a scan: choose another --out or --resume")
        with storage_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with complete(path) as draft:
                write(draft)
        return cls(path)

    @classmethod
    def resume(cls, path: Path, digests: Mapping[str, str]) -> ScanStore:
        """Open a store to continue its scan; discard damaged views and remains of a killed write.

        ``digests``: ``image_digests`` of the scenario that is to be continued.

        Raises:
            ScanExistsError: the store holds the scan of another scenario.
            DamagedError: the place of a file or folder is occupied, or no view of a store without
                digests fits its metadata; nothing has been changed.
        """
        store = cls(path)
        store.refuse_other(digests)
        damages = store.damage
        taken = views_taken(path)
        if not store.vouched and len(taken) > 1 and taken <= {damage.view for damage in damages}:
            problem = "no view fits the metadata, which are damaged and cannot be reconstructed"
            raise DamagedError([f"{path}: {problem}; nothing has been changed"], damages)
        clear_paths(path, damages)
        for damage in damages:
            log.warning("%s: %s; its view will be taken again", path, damage)
        with storage_errors(path):
            for view in {damage.view for damage in damages if damage.view is not None}:
                (path / status_file(view)).unlink(missing_ok=True)
            if sweeps_damage(path):  # a damaged last view counts, too
                (path / SWEEPS).unlink(missing_ok=True)
            store._remove_unfinished()
        return store

    def refuse_other(self, digests: Mapping[str, str]) -> None:
        """Check that the store holds the scan of a scenario, given its ``image_digests``.

        Raises:
            ScanExistsError: the store holds the scan of another scenario.
        """
        own = self.digests
        differ = [
            f"{name}: {own.get(name, 'none')[:12]} there, {digest[:12]} here"
            for name, digest in digests.items()
            if own.get(name) != digest
        ]
        if differ:
            raise ScanExistsError(
                f"{self.path} holds the scan of another scenario (digest of {'; '.join(differ)}"
                "): choose another --out"
            )

    @property
    def acquired(self) -> int:
        """Number of views on disk; views are acquired in order.

        Raises:
            DamagedError: a view before the last acquired one is missing.
        """
        missing = self.missing
        if lost := [view for views in missing if views.stop < self.views for view in views]:
            raise damaged(self.path, *(Damage(status_file(v), "missing", v) for v in lost))
        return missing[0].start if missing else self.views

    @property
    def missing(self) -> list[range]:
        """Views that are not on disk, as ranges of consecutive views.

        Raises:
            DamagedError: a status is damaged.
        """
        own = (is_acquired(self.path, view) for view in range(self.views))
        taken = np.array([True, *own, True])
        steps = np.flatnonzero(np.diff(taken)).reshape(-1, 2)
        return [range(int(first), int(last)) for first, last in steps]

    @property
    def damage(self) -> list[Damage]:
        """Damaged files of the views, or of their sweeps. This reads every file."""
        return view_damage(self.path)

    @property
    def vouched(self) -> bool:
        """True if the store has a manifest, as all stores from format 4 on do."""
        return (self.path / FOLDER).is_dir()

    @property
    def views(self) -> int:
        """Number of views of the complete scan; if it ended early, of those until then."""
        complete = self.sweeps.complete
        return self.planned_views if complete is None else complete

    @property
    def planned_views(self) -> int:
        """Number of views that were commanded."""
        return self._array("status").shape[0]

    @cached_property
    def sweeps(self) -> Sweeps:
        """Comparisons and end of a scan with ``until``; empty for all other scans.

        Raises:
            DamagedError: their file is damaged.
        """
        return read_sweeps(self.path)

    def note(self, sweeps: Sweeps) -> None:
        """Store comparisons and end of a scan with ``until``, of views that are on disk.

        Raises:
            StorageError: the disk is full.
        """
        with storage_errors(self.path), postponed():
            write_sweeps(self.path, sweeps)
        self.__dict__["sweeps"] = sweeps

    def _read(self, name: str, which: Any = ...) -> NDArray[Any]:
        """Return the values of an array for one, some or all views; finite, except clearances."""
        with readable(self.path, name):
            values = np.asarray(self._array(name)[which])
        one = isinstance(which, int)
        for row, of_view in enumerate([values] if one else values):  # one small mask at a time
            wrong = np.isinf(of_view) if name == "clearance_mm" else ~np.isfinite(of_view)
            if wrong.any():
                view = which if one else row + (getattr(which, "start", None) or 0)
                raise InputError(f"{self.path}: {name} of view {view} is not finite")
        return values

    @property
    def settings(self) -> ScanSettings:
        """Scenario of the scan, or what is known of an imported one."""
        settings = self._stated_settings()
        panel, image = settings.detector.panel.shape, self._array("transmission").shape[1:]
        if panel != image:
            raise InputError(
                f"{self.path}: its scenario has {panel} pixels, but its images have {image}"
            )
        return settings

    def _stated_settings(self) -> ScanSettings:
        attributes = self._group.attrs
        data = json_of(str(attributes["settings" if self._format >= IMPORTED else "scenario"]))
        if is_imported(data):
            return load_imported(data)
        if isinstance(data.get("motion"), dict) and not self._has("plan"):
            # Stores without plans predate all other schemes.
            data["motion"].setdefault("scheme", "reactive")
        return parse_scenario(data)

    @property
    def scenario(self) -> Scenario:
        """Scenario of the scan.

        Raises:
            InputError: the scan was imported.
        """
        return scenario_in(self.settings)

    @property
    def digests(self) -> dict[str, str]:
        """Digest of the images, computed from their scenario and its files at scan time.

        Format 1 stored another digest, so this one is computed from the stored scenario and its
        current files; files changed since the scan go unnoticed. Format 2 also stored believed
        poses and their digest. The digest of an imported scan is that of its stored images.
        """
        if isinstance(settings := self._stated_settings(), ImportedSettings):
            return {"images": self._digest_of_images()}
        if self._format == 1:
            assert isinstance(settings, Scenario)
            return image_digests(settings)
        return cast("dict[str, str]", self._group.attrs["digests"])

    def _digest_of_images(self) -> str:
        rows = (read_row(self.path, view) for view in range(self.acquired))
        files = (f"{f} {row[f]}" for row in rows for f in row if f.startswith("transmission/"))
        return digest_of("\n".join(files).encode())

    @property
    def digest_0_1(self) -> str | None:
        """Digest that version 0.1 gave the scan; None for later versions."""
        return str(self._group.attrs["digest"]) if self._format == 1 else None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, source arm first."""
        return tuple(self._group.attrs.get("joint_names", ()))

    @property
    def plan(self) -> MotionPlan | None:
        """Motion plan of the arms; None if they solve each target as it comes.

        Raises:
            InputError: the plan is damaged.
        """
        if not self._has("plan"):
            return None
        import zarr

        from twinct.robots.motion import LARGEST_PLAN_BYTES, plan_of_arrays

        with readable(self.path, "plan"):
            group = self._group["plan"]
            if not isinstance(group, zarr.Group):
                raise InputError(f"{self.path}/plan: found an array, expected a group")
            data = dict(group.arrays())
            if (total := sum(array.nbytes for array in data.values())) > LARGEST_PLAN_BYTES:
                raise InputError(
                    f"{self.path}/plan: its arrays claim {total:.3g} bytes; at most "
                    f"{LARGEST_PLAN_BYTES:.3g} are read"
                )
            for name, array in data.items():
                ZarrChunks(array, self.path, f"{self.path}/plan/{name}").require(...)
            arrays = {name: np.asarray(array[:]) for name, array in data.items()}
            return plan_of_arrays({**arrays, **group.attrs}, f"{self.path}/plan")

    @property
    def bad_pixels(self) -> NDArray[np.bool_] | None:
        """Map of bad pixels, (rows, columns); None if there are none.

        Raises:
            InputError: the store's format is too old to hold the map, and the scenario's file with
                the map is no longer usable.
        """
        if self._has(BAD_PIXELS):
            return self._read(BAD_PIXELS)
        if self._format >= WITH_MANIFEST:
            return None
        scenario = self.scenario
        return bad_pixels_of(scenario.detector, scenario.seed)

    @property
    def mas(self) -> NDArray[np.float64] | None:
        """Tube load of each view, (views,), mAs; None if all have ``source.mas``.

        Raises:
            InputError: a tube load is not positive.
        """
        if not self._has(MAS):
            return None
        mas = self._read(MAS)[: self.views]
        if (wrong := mas <= 0).any():
            raise InputError(f"{self.path}: {MAS} of view {int(wrong.argmax())} is not above 0")
        return mas

    def state(self, view: int) -> NDArray[np.float64]:
        """Return the full simulator state of a view."""
        return self._read("state", view)

    def transmission(self, view: int) -> NDArray[np.float32]:
        """Return the transmission I/I0 of a view, (rows, columns)."""
        return self._read("transmission", view)

    @cached_property
    def stored_frames(self) -> tuple[str, ...]:
        """Names that ``frame`` accepts: the stored ones of ``raw``, ``flat`` and ``dark``."""
        return tuple(name for name in FRAMES if self._has(name))

    def frame(self, name: str, view: int) -> NDArray[np.float32]:
        """Return the ``raw``, ``flat`` or ``dark`` image of a view, grey values, (rows, columns).

        Raises:
            InputError: the scan does not store such images.
        """
        if name not in self.stored_frames:
            there = ", ".join(self.stored_frames) or "transmission only"
            raise InputError(
                f"{self.path} keeps {there} and no {quoted(name)} images; request them with "
                "detector.keep"
            )
        return self._read(name, view)

    def write(
        self,
        index: int,
        transmission: NDArray[np.float32],
        reached: Reached | None = None,
        frames: ViewImages | None = None,
    ) -> None:
        """Write one view to disk; it counts once its status is written.

        Args:
            index: index of the view.
            transmission: I/I0, (rows, columns).
            reached: state of the robots; None for an imported scan, which knows none.
            frames: images behind the transmission, if ``detector.keep`` requests them.

        Raises:
            StorageError: the disk is full. Views written before stay intact.
            InputError: data of the view do not fit the shape of the store's arrays, whose metadata
                must be damaged; nothing is written.
        """
        columns = {} if reached is None else columns_of(reached)
        if self._format < 3:  # begun by an older twinct, which did not store them
            del columns["joint_velocity"], columns["joint_torque"]
        raw = {name: getattr(frames, name) for name in self.stored_frames}
        images = {"transmission": transmission, **raw}
        for name, values in {**images, **columns}.items():
            if np.shape(values) != (shape := self._array(name).shape[1:]):
                raise InputError(
                    f"{self.path}: {name} of view {index} has shape {np.shape(values)}, the scan "
                    f"{shape}: its metadata are damaged, or another twinct wrote them"
                )
        with storage_errors(self.path), postponed():
            for name, image in images.items():
                self._array(name)[index] = image
            for name, values in columns.items():
                self._put(name, index, np.asarray(values, dtype="<f8"))
            self._files.seal(index)
            mark_acquired(self.path, index)

    def read(self, *, unfinished: bool = False) -> Scan:
        """Return the scan, with all images.

        ``unfinished``: return the views on disk, even if there are more to come.

        Raises:
            ScanExistsError: some views are not acquired yet.
        """
        if self.acquired < self.views and not unfinished:
            raise ScanExistsError(
                f"{self.path} holds {self.acquired} of {self.views} views: "
                "finish it with 'twinct run --resume'"
            )
        provenance = self.provenance
        panel = provenance.settings.detector.panel
        with readable(self.path, "poses"):
            for name in provenance.own:
                if name != "believed" and (poses := provenance.poses(name)) is not None:
                    _ = poses.geometry(panel)
        images = self._read("transmission", slice(self.acquired))
        mas = None if self.mas is None else self.mas[: len(images)]
        return Scan(provenance, images, bad_pixels=self.bad_pixels, mas=mas)

    @cached_property
    def kind(self) -> type[Provenance]:
        """Kind of the provenance, which names the geometries."""
        if isinstance(self._stated_settings(), ImportedSettings):
            return Imported
        return self._of_arms

    @property
    def _of_arms(self) -> type[Simulated]:
        return Recorded if self._group.attrs.get("recorded") else Simulated

    @property
    def _taken(self) -> str:
        """Name below which the poses at exposure are stored."""
        # Earlier versions stored the stated poses as executed ones of a gantry.
        return self.kind.kept if self._format >= IMPORTED else "executed"

    @property
    def provenance(self) -> Provenance:
        """Provenance of the views on disk."""
        settings, views = self.settings, self.acquired
        if isinstance(settings, ImportedSettings):
            files = tuple(self._group.attrs.get("files", ()))
            return Imported(settings, self._pairs(self._taken, slice(views)), files)
        exposure: Any = self._read(EXPOSURE, slice(views)) if self._has(EXPOSURE) else np.zeros(0)
        return self._of_arms(
            scenario=scenario_in(settings),
            commanded=self._pairs("commanded", slice(views)),
            executed=self._pairs("executed", slice(views)),
            executed_object=self._poses("executed/object", slice(views)),
            joint_names=self.joint_names,
            joints=self._read("joints", slice(views)),
            simulated_s=self._read("simulated_s", slice(views)),
            clearance_mm=self._read("clearance_mm", slice(views)),
            exposure=tuple(map(PosePairs.from_sevens, exposure.tolist())),
        )

    def readings(self, first: int, stop: int) -> Readings:
        """Return poses and state of the robots in views ``first`` to ``stop - 1``, on disk."""
        views = slice(first, stop)
        taken = self._pairs(self._taken, views)
        if self.kind is Imported:
            return Readings(taken, (), np.zeros((len(taken), 0)), np.zeros(0), np.zeros(0))
        of_robots = (self._read(name, views) for name in ("joints", "simulated_s", "clearance_mm"))
        return Readings(taken, self._poses("executed/object", views), *of_robots)

    def _put(self, name: str, index: int, values: NDArray[Any]) -> None:
        """Write one uncompressed chunk: just the bytes of the values, as Zarr 3 specifies.

        Zarr itself takes 1 to 2 ms for each of a view's twenty small chunks.
        """
        file, data = f"{name}/{chunk_name(index, values.ndim)}", values.tobytes()
        self._files.note(file, data)
        with open(f"{self.path}/{file}", "wb", buffering=0) as chunk:
            chunk.write(data)

    @property
    def commanded(self) -> PosePairs:
        """Commanded poses of all views, including those not yet acquired.

        Those of an imported scan are the stated ones.
        """
        names = ("commanded", STATED)
        return self._pairs(next(name for name in names if self._has(name)), slice(self.views))

    @property
    def reported(self) -> NamedGeometry:
        """Geometry that the machine reports, of the views on disk."""
        return self.provenance.reported

    def _pairs(self, which: str, views: slice) -> PosePairs:
        sides = (self._poses(f"{which}/{body}", views) for body in ("source", "detector"))
        return PosePairs(*sides)

    def _poses(self, name: str, views: slice) -> tuple[Pose, ...]:
        with readable(self.path, name):
            return tuple(map(Pose, *(self._read(f"{name}{end}", views) for end in ("", "_quat"))))

    def _has(self, name: str) -> bool:
        """Return True if an array or group exists. Zarr reads its metadata for this."""
        with readable(self.path, name):
            return name in self._group

    def _array(self, name: str) -> Any:
        if name not in self._arrays:
            array = self._group[name]
            chunks = ZarrChunks(array, self.path, f"{self.path}/{name}")
            if "/" in array.metadata.encode_chunk_key((0,) * array.ndim):
                chunks.require(...)  # of all views, and compared when the store was opened
            else:
                self._files.packings[name] = chunks.packing
            self._arrays[name] = array
        return self._arrays[name]

    def _remove_unfinished(self) -> None:
        """Delete temporary files, and chunks of views without status."""
        unfinished = {view for views in self.missing for view in views}
        for file in self.path.rglob("*"):
            if view_of(file.name) in unfinished or file.suffix == ".partial":
                file.unlink()
