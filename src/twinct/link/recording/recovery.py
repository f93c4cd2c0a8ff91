"""Recovery of a scan store from recordings of the scan alone."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.plain_json import json_of
from twinct.core.files.private import temporary_folder
from twinct.geometry.wire import PosePairs, Reached
from twinct.link.recording.contents import Contents
from twinct.link.recording.foreign import foreign_scan
from twinct.link.recording.recorder import COMMANDED, PLAN, SCENARIO
from twinct.robots.motion import load_plan
from twinct.scan import Imported, NamedGeometry, ScanStore, SimulationBuilder
from twinct.scenario import Scenario, parse_scenario
from twinct.scenario.imported import ScanSettings

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.xray import Imager


@dataclass(frozen=True, eq=False)
class Recovered(ABC):
    """A scan from recordings.

    Attributes:
        contents: content of the recordings.
        views: view of each complete stamp.
        missing: views that the recordings do not contain.
    """

    contents: Contents
    views: Mapping[int, int]
    missing: tuple[int, ...]

    @property
    def missing_in_words(self) -> str:
        """Missing views as text, such as ``views 3, 5 to 9``."""
        stretches = groupby(enumerate(self.missing), lambda pair: pair[1] - pair[0])
        runs = [[view for _, view in run] for _, run in stretches]
        words = ", ".join(f"{r[0]} to {r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs)
        return f"view {words}" if len(self.missing) == 1 else f"views {words}"

    @property
    @abstractmethod
    def settings(self) -> ScanSettings:
        """Settings of the scan."""

    @property
    def geometries(self) -> tuple[NamedGeometry, ...]:
        """Further geometries that the recordings state."""
        return ()

    def imager(self) -> Imager | None:
        """Return the imager of the images that a scan keeps and no recording contains, if any."""
        return None

    def rebuild(self, path: Path, imager: Imager | None) -> ScanStore:
        """Create the scan store; after an error, it is not complete.

        Args:
            path: path of the store.
            imager: the one of ``imager``.

        Raises:
            InputError: an image is invalid.
            ScanExistsError: the store already exists.
            StorageError: the store cannot be written.
        """
        store = self._created(path)
        try:
            for stamp, pixels in self.contents.images(self.views):
                self._write(store, stamp, pixels, imager)
        except (InputError, ValueError) as error:
            raise InputError(f"{self.contents.names}: {error}") from None
        return store

    @abstractmethod
    def _created(self, path: Path) -> ScanStore:
        """Create the store without views."""

    def _write(
        self, store: ScanStore, stamp: int, pixels: NDArray[np.float32], imager: Imager | None
    ) -> None:
        store.write(self.views[stamp], pixels)


@dataclass(frozen=True, eq=False)
class RecoveredScan(Recovered):
    """A scan from recordings by twinct.

    Attributes:
        scenario: scenario of the scan.
        commanded: poses of all views.
        reached: state of the robots in each complete view, by stamp.
        plan: plan that the arms followed, if any.
        digests: digests of the scenario and its files at scan time.
    """

    scenario: Scenario
    commanded: PosePairs
    reached: Mapping[int, Reached]
    plan: MotionPlan | None
    digests: dict[str, str]

    @property
    def settings(self) -> Scenario:
        """The scenario."""
        return self.scenario

    def imager(self) -> Imager | None:
        """Return the imager of the images that ``detector.keep`` requests, if any."""
        if not self.scenario.detector.keep:
            return None
        return SimulationBuilder(self.scenario, self.plan).imager()

    def _created(self, path: Path) -> ScanStore:
        any_ = next(iter(self.reached.values()))
        robots = any_.joint_names, len(any_.state), self.plan
        more = {"digests": self.digests, "mas": SimulationBuilder(self.scenario, self.plan).mas}
        return ScanStore.create(path, self.scenario, self.commanded, *robots, **more)

    def _write(
        self, store: ScanStore, stamp: int, pixels: NDArray[np.float32], imager: Imager | None
    ) -> None:
        view, reached = self.views[stamp], self.reached[stamp]
        frames = imager and imager.frame(reached.path, view, reached.before)
        store.write(view, pixels, reached, frames)


@dataclass(frozen=True, eq=False)
class ForeignScan(Recovered):
    """A scan from recordings by other software: an imported scan, of an object not known.

    Attributes:
        provenance: panel, reconstruction, and the recorded poses of source and panel.
        targets: the poses that were asked for, if they are known.
    """

    provenance: Imported
    targets: NamedGeometry | None

    @property
    def settings(self) -> ScanSettings:
        """The panel and a reconstruction."""
        return self.provenance.settings

    @property
    def geometries(self) -> tuple[NamedGeometry, ...]:
        """The targets, if they are known."""
        return (self.targets,) if self.targets else ()

    def _created(self, path: Path) -> ScanStore:
        return ScanStore.create_imported(path, self.provenance, None)


def read_recordings(paths: Sequence[Path]) -> RecoveredScan | ForeignScan:
    """Read the recordings of one scan, by twinct or by other software with the same topics.

    Args:
        paths: paths of the files, in any order.

    Raises:
        InputError: a file is no recording, or no view is complete.
    """
    contents = Contents.of(paths)
    if contents.facts:
        return _own(contents)
    found = foreign_scan(contents)
    return ForeignScan(contents, found.views, found.missing, found.provenance, found.targets)


def _own(contents: Contents) -> RecoveredScan:
    if missing := {SCENARIO, COMMANDED} - contents.files.keys():
        raise InputError(
            f"{contents.names}: cut off before {' and '.join(sorted(missing))}, so there is "
            "nothing to import"
        )
    try:
        scenario = parse_scenario(json_of(contents.files[SCENARIO]))
    except ValueError as error:
        raise InputError(f"{contents.names}: {SCENARIO}: not valid JSON: {error}") from None
    with temporary_folder() as folder:
        for file in {COMMANDED, PLAN} & contents.files.keys():
            (folder / file).write_bytes(contents.files[file])
        commanded = NamedGeometry.read(folder / COMMANDED).poses
        plan = None
        if PLAN in contents.files:
            plan = load_plan(folder / PLAN)
    views, samples = contents.view_of, scenario.source.motion_samples
    reached = {
        stamp: got
        for stamp in contents.imaged
        if views.get(stamp, len(commanded)) < len(commanded)
        and (got := contents.reached(stamp, samples)) is not None
    }
    if not reached:
        problems = ("no view is complete, so there is nothing to import", *contents.problems)
        raise InputError(f"{contents.names}: {'; '.join(problems)}")
    views = {stamp: views[stamp] for stamp in reached}
    digests = {"images": contents.facts["images"]}
    missing = tuple(sorted(set(range(len(commanded))) - set(views.values())))
    return RecoveredScan(contents, views, missing, scenario, commanded, reached, plan, digests)
