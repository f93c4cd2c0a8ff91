"""Reader of the page's content from the folder of a run, finished or not, or of a scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.boundary import no_file
from twinct.core.files.plain_json import json_of
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.observers import IterationDone
from twinct.recon.volume import Volume
from twinct.runs import Folder
from twinct.runs.checkpoints import read_checkpoint
from twinct.runs.folder import read_metrics
from twinct.runs.judgement import Judgement
from twinct.runs.reconstruction_folder import stored_reconstructions
from twinct.scan import (
    NamedGeometry,
    Readings,
    ScanStore,
    SimulationBuilder,
    named_geometries,
    scenario_in,
)
from twinct.scenario import Scenario
from twinct.scenario.imported import ScanSettings
from twinct.viewer.locate import folder_of_run
from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show


class RunFolder:
    """A folder of a run or of an imported scan, of which each look reads only new data."""

    def __init__(self, path: Path, *, live: bool = False) -> None:
        """Open the folder of a run, or its scan.zarr; ``live`` if this process writes it.

        Raises:
            InputError: the path is no folder of a run.
        """
        self.paths, self._live = Folder(folder_of_run(path)), live
        self._store: ScanStore | None = None
        self._first: PosePairs | None = None
        self._read: list[Readings] = []
        self._known: dict[Path, tuple[object, Any]] = {}
        self._reported: tuple[int, NamedGeometry | None] = 0, None
        self._show: Show | None = None
        self._iteration: IterationDone | None = None
        self._course: dict[str, list[float]] = {}

    @property
    def under_way(self) -> bool:
        """True if the run is not finished; an imported scan is none."""
        return self._is_run and not all(path.exists() for path in self.paths.results)

    @cached_property
    def _is_run(self) -> bool:
        """True if a scenario says what there will be; else there is what the folder holds."""
        return isinstance(self._settings, Scenario)

    @cached_property
    def _settings(self) -> ScanSettings:
        if self.paths.scenario.is_file():
            return self.paths.settings_of_scan()
        return ScanStore(self.paths.scan).settings

    def iterated(self, event: IterationDone) -> None:
        """Take an iteration of a reconstruction in this process, instead of reading its volume."""
        course = self._course.setdefault(event.geometry, [])
        if len(course) == event.iteration - 1:
            course.append(event.residual)
        self._iteration = event

    def look(self) -> Show:
        """Return the current state of the run.

        Raises:
            InputError: the folder is gone, or damaged.
        """
        needed = self.paths.path if self._store is None else self.paths.scan
        if not needed.is_dir():
            raise InputError(f"{needed} is gone: the page shows its last state")
        try:
            if self._store is None and self.paths.scan.is_dir():
                self._store = ScanStore(self.paths.scan)
            self._show = self._of_scenario() if self._store is None else self._of_store(self._store)
        except FileNotFoundError as error:
            raise InputError(f"{error.filename} is gone: the page shows its last state") from None
        return self._show

    def _of_scenario(self) -> Show:
        """Return the state of a run without a stored view."""
        scenario = scenario_in(self._settings)
        commanded = PosePairs.from_geometry(SimulationBuilder(scenario).requested)
        return Show(self.paths.path.name, scenario, commanded, state="no view is stored yet")

    def _of_store(self, store: ScanStore) -> Show:
        before = self._show
        acquired, read = store.acquired, sum(len(part.joints) for part in self._read)
        if acquired > read:
            self._read.append(store.readings(read, acquired))
        if before is None or not before.poses:
            base = Show(
                self.paths.path.name,
                self._settings,
                self._first_of(store),
                store.kind,
                plan=store.plan,
                transmission=store.transmission,
            )
        else:
            base = before
        taken, objects, joints, clearance = self._joined(store)
        poses = self._poses(store, taken, acquired)
        made = self._made(base, poses)
        volumes, waiting = self._volumes()
        residuals, view_residuals = self._residuals()
        state, problems = self._said(store, acquired, volumes, waiting)
        return replace(
            base,
            poses=poses,
            made=made,
            objects=objects,
            joints=joints,
            clearance_mm=clearance,
            volumes=volumes,
            residuals=residuals,
            view_residuals=view_residuals,
            state=state,
            problems=problems,
        )

    def _first_of(self, store: ScanStore) -> PosePairs:
        if self._first is None:
            self._first = store.commanded
        return self._first

    def _joined(self, store: ScanStore) -> tuple[PosePairs, tuple[Pose, ...], Floats, Floats]:
        parts = self._read
        taken = PosePairs.joined(part.taken for part in parts)
        objects = tuple(pose for part in parts for pose in part.objects)
        joints = [part.joints for part in parts] or [np.zeros((0, len(store.joint_names)))]
        clearance = [part.clearance_mm for part in parts] or [np.zeros(0)]
        return taken, objects, np.concatenate(joints), np.concatenate(clearance)

    def _poses(self, store: ScanStore, taken: PosePairs, acquired: int) -> dict[str, PosePairs]:
        """Return taken, reported and derived poses; compute believed ones unless stored."""
        by_name = {store.kind.kept: taken}
        derived = {
            name: named.poses
            for name, named in self._cached(self.paths.geometries, named_geometries, {}).items()
            if len(named.poses) == acquired
        }
        if "believed" in derived:
            by_name["believed"] = derived["believed"]
        elif acquired:
            views, poses = self._reported
            # This slows down with each view, so a running scan does not do it after every view.
            if views < acquired and (acquired == store.views or acquired >= 1.1 * views):
                poses = store.reported
                self._reported = acquired, poses
            if poses is not None and self._reported[0] <= acquired:
                by_name.setdefault(poses.name, poses.poses)
        own = store.kind.own
        return by_name | {name: poses for name, poses in derived.items() if name not in own}

    def _made(self, base: Show, poses: Mapping[str, PosePairs]) -> dict[str, ScanGeometry]:
        """Return the geometries of these poses; for those taken, build only new views."""
        panel, before, first = base.settings.detector.panel, base.made, base.first_name
        made = {first: before.get(first) or base.first.geometry(panel)}
        for name, now in poses.items():
            old = before.get(name)
            if name == first:
                continue
            if not len(now):
                continue
            if old is None or (name != base.kept and now is not base.poses.get(name)):
                made[name] = now.geometry(panel)
            elif len(old) < len(now):
                rest = PosePairs(now.source[len(old) :], now.detector[len(old) :])
                made[name] = ScanGeometry.joined([old, rest.geometry(panel)])
            else:
                made[name] = old
        return made

    def _volumes(self) -> tuple[dict[str, Volume], bool]:
        """Return all volumes, and True while a run's own is still to come."""
        files = {RECONSTRUCTION: self.paths.volume}
        if self.paths.reconstructions.is_dir():
            for path in sorted(self.paths.reconstructions.glob("*/volume.nii")):
                files[path.parent.name] = path
        files[TRUTH] = self.paths.truth
        volumes = {
            name: volume
            for name, file in files.items()
            if (volume := self._cached(file, Volume.read, None)) is not None
        }
        if RECONSTRUCTION not in volumes and (under_way := self._checkpoint()) is not None:
            volumes = {RECONSTRUCTION: under_way[0], **volumes}
        return volumes, self._is_run and not self.paths.volume.exists()

    def _checkpoint(self) -> tuple[Volume, str, int, tuple[float, ...]] | None:
        """Return volume, geometry, number and residuals of a reconstruction's newest iteration."""
        if (iteration := self._iteration) is not None:
            course = tuple(self._course[iteration.geometry])
            return iteration.volume, iteration.geometry, iteration.iteration, course
        files = sorted(self.paths.checkpoints.glob("*.npz"), key=lambda f: f.name)
        if not files:
            return None
        grid = self._settings.reconstruction.volume_grid

        def read(file: Path) -> tuple[Volume, str, int, tuple[float, ...]] | None:
            arrays = read_checkpoint(file, grid)
            array, residuals = arrays["volume"], json_of(str(arrays["residuals"]))
            if array.shape != grid.shape:
                return None
            which, _, number = file.stem.rpartition("-")
            return Volume(array, grid), which.rpartition("-")[0], int(number), tuple(residuals)

        try:
            return self._cached(files[-1], read, None)
        except (OSError, ValueError, KeyError, InputError):
            return None  # the next checkpoint has just replaced this one

    def _residuals(self) -> tuple[dict[str, tuple[float, ...]], dict[str, Floats]]:
        """Return the residuals of iterations and, of volumes judged without a truth, of views."""
        residuals = self._cached(self.paths.metrics, read_metrics, {}).get("residuals", {})
        by_name = {name: tuple(values) for name, values in residuals.items()}
        if not by_name and (under_way := self._checkpoint()) is not None:
            by_name = {under_way[1]: under_way[3]}
        by_view: dict[str, Floats] = {}
        further = self._cached(self.paths.reconstructions, stored_reconstructions, {})
        for name, one in further.items():
            if one.residuals:
                by_name[name] = one.residuals
            if isinstance(one.figures, Judgement):
                by_view[name] = np.array(one.figures.residual_by_view)
        return by_name, by_view

    def _said(
        self, store: ScanStore, acquired: int, volumes: Mapping[str, Volume], waiting: bool
    ) -> tuple[str, tuple[str, ...]]:
        """Return the state in one line, and the missing parts."""
        state = f"{acquired} of {store.views} views"
        under_way = self._checkpoint() if waiting else None
        if under_way is not None:
            return f"{state}; reconstruction, iteration {under_way[2]}", ()
        if RECONSTRUCTION in volumes or self._live:
            return state, ()
        if not self._is_run:
            way = f"{self.paths.path} holds no volume yet; 'twinct reconstruct' makes one"
            return state, () if volumes else (way,)
        way = (
            "the scan is incomplete" if acquired < store.views else "the reconstruction is not done"
        )
        return state, (f"{self.paths.volume} does not exist yet, {way}: no slices and no surface",)

    def _cached(self, path: Path, read: Any, otherwise: Any) -> Any:
        """Return the content of a file or folder; read it again only if it has changed."""
        try:
            stat = path.stat()
        except FileNotFoundError:
            return otherwise
        if why := no_file(path, folder=True):  # a pipe, perhaps, which would block
            raise InputError(f"{path} {why}")
        mark = stat.st_mtime_ns, stat.st_size, stat.st_ino
        known = self._known.get(path)
        if known is None or known[0] != mark:
            if path.parent == self.paths.checkpoints:
                self._known = {
                    file: entry
                    for file, entry in self._known.items()
                    if file.parent != self.paths.checkpoints
                }
            self._known[path] = known = mark, read(path)
        return known[1]
