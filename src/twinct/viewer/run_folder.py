"""Reader of the page's content from the folder of a run, finished or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
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
from twinct.scan import OWN, Readings, ScanStore, SimulationBuilder, named_geometries
from twinct.scenario import Scenario
from twinct.viewer.locate import folder_of_run
from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show


class RunFolder:
    """A run's folder, of which each look reads only new data."""

    def __init__(self, path: Path, *, live: bool = False) -> None:
        """Open the folder of a run, or its scan.zarr; ``live`` if this process writes it.

        Raises:
            InputError: the path is no folder of a run.
        """
        self.paths, self._live = Folder(folder_of_run(path)), live
        self._store: ScanStore | None = None
        self._commanded: PosePairs | None = None
        self._read: list[Readings] = []
        self._known: dict[Path, tuple[object, Any]] = {}
        self._reported: tuple[int, PosePairs | None] = 0, None
        self._show: Show | None = None
        self._iteration: IterationDone | None = None
        self._course: dict[str, list[float]] = {}

    @property
    def under_way(self) -> bool:
        """True if the run is not finished."""
        return not all(path.exists() for path in self.paths.results)

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
        scenario = self.paths.scenario_of_run()
        commanded = PosePairs.from_geometry(SimulationBuilder(scenario).requested)
        return Show(self.paths.path.name, scenario, commanded, state="no view is stored yet")

    def _of_store(self, store: ScanStore) -> Show:
        before = self._show
        acquired, read = store.acquired, sum(len(part.joints) for part in self._read)
        if acquired > read:
            self._read.append(store.readings(read, acquired))
        if before is None or not before.poses:
            scenario = self._scenario(store)
            base = Show(
                self.paths.path.name,
                scenario,
                self._commanded_of(store),
                plan=store.plan,
                transmission=store.transmission,
            )
        else:
            base = before
        executed, objects, joints, clearance = self._joined(store)
        poses = self._poses(store, executed, acquired)
        made = self._made(base, poses)
        volumes, waiting = self._volumes()
        residuals = self._residuals()
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
            state=state,
            problems=problems,
        )

    def _scenario(self, store: ScanStore) -> Scenario:
        if self.paths.scenario.is_file():
            return self.paths.scenario_of_run()
        return store.scenario

    def _commanded_of(self, store: ScanStore) -> PosePairs:
        if self._commanded is None:
            self._commanded = store.commanded
        return self._commanded

    def _joined(self, store: ScanStore) -> tuple[PosePairs, tuple[Pose, ...], Floats, Floats]:
        parts = self._read
        executed = PosePairs.joined(part.executed for part in parts)
        objects = tuple(pose for part in parts for pose in part.objects)
        joints = [part.joints for part in parts] or [np.zeros((0, len(store.joint_names)))]
        clearance = [part.clearance_mm for part in parts] or [np.zeros(0)]
        return executed, objects, np.concatenate(joints), np.concatenate(clearance)

    def _poses(self, store: ScanStore, executed: PosePairs, acquired: int) -> dict[str, PosePairs]:
        """Return executed, believed and derived poses; compute believed ones unless stored."""
        by_name = {"executed": executed}
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
                poses = store.reported.poses
                self._reported = acquired, poses
            if poses is not None and self._reported[0] <= acquired:
                by_name["believed"] = poses
        return by_name | {name: poses for name, poses in derived.items() if name not in OWN}

    def _made(self, base: Show, poses: Mapping[str, PosePairs]) -> dict[str, ScanGeometry]:
        """Return the geometries of these poses; for executed poses, build only new views."""
        panel, before = base.scenario.detector.panel, base.made
        made = {"commanded": before.get("commanded") or base.commanded.geometry(panel)}
        for name, now in poses.items():
            old = before.get(name)
            if not len(now):
                continue
            if old is None or (name != "executed" and now is not base.poses.get(name)):
                made[name] = now.geometry(panel)
            elif len(old) < len(now):
                rest = PosePairs(now.source[len(old) :], now.detector[len(old) :])
                made[name] = ScanGeometry.joined([old, rest.geometry(panel)])
            else:
                made[name] = old
        return made

    def _volumes(self) -> tuple[dict[str, Volume], bool]:
        """Return all volumes, and True while the run's own is still to come."""
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
        return volumes, not self.paths.volume.exists()

    def _checkpoint(self) -> tuple[Volume, str, int, tuple[float, ...]] | None:
        """Return volume, geometry, number and residuals of a reconstruction's newest iteration."""
        if (iteration := self._iteration) is not None:
            course = tuple(self._course[iteration.geometry])
            return iteration.volume, iteration.geometry, iteration.iteration, course
        files = sorted(self.paths.checkpoints.glob("*.npz"), key=lambda f: f.name)
        if not files:
            return None
        grid = self._scenario_now().reconstruction.volume_grid

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

    def _scenario_now(self) -> Scenario:
        assert self._store is not None
        return self._show.scenario if self._show else self._scenario(self._store)

    def _residuals(self) -> Mapping[str, tuple[float, ...]]:
        residuals = self._cached(self.paths.metrics, read_metrics, {}).get("residuals", {})
        by_name = {name: tuple(values) for name, values in residuals.items()}
        if not by_name and (under_way := self._checkpoint()) is not None:
            by_name = {under_way[1]: under_way[3]}
        return by_name

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
