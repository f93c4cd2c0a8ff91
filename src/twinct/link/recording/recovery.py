"""Recovery of a scan store from recordings of the scan alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from twinct.core.errors import InputError
from twinct.core.files.plain_json import json_of
from twinct.core.files.private import temporary_folder
from twinct.core.files.writing import storage_errors
from twinct.geometry.wire import PosePairs, Reached
from twinct.link.recording.contents import Contents
from twinct.link.recording.foreign import foreign_scan
from twinct.link.recording.recorder import COMMANDED, PLAN, SCENARIO
from twinct.robots.motion import load_plan
from twinct.scan import NamedGeometry, ScanStore, SimulationBuilder
from twinct.scenario import Scenario, parse_scenario
from twinct.trajectory import write_views

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.xray.chain import ViewImages

VIEWS_FILE = "views.csv"
"""List of views beside the store, for a scan that twinct did not record."""


@dataclass(frozen=True, eq=False)
class RecoveredScan:
    """A scan from recordings.

    Attributes:
        contents: content of the recordings.
        scenario: scenario of the scan.
        commanded: poses of all views.
        reached: state of the robots in each complete view, by stamp.
        views: view of each of these stamps.
        missing: views that the recordings do not contain.
        plan: plan that the arms followed, if any.
        digests: digests of the scenario and its files at scan time; None for recordings of other
            software.
    """

    contents: Contents
    scenario: Scenario
    commanded: PosePairs
    reached: Mapping[int, Reached]
    views: Mapping[int, int]
    missing: tuple[int, ...]
    plan: MotionPlan | None = None
    digests: dict[str, str] | None = None

    @property
    def missing_in_words(self) -> str:
        """Missing views as text, such as ``views 3, 5 to 9``."""
        stretches = groupby(enumerate(self.missing), lambda pair: pair[1] - pair[0])
        runs = [[view for _, view in run] for _, run in stretches]
        words = ", ".join(f"{r[0]} to {r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs)
        return f"view {words}" if len(self.missing) == 1 else f"views {words}"

    def rebuild(
        self, path: Path, folder: Path, frames_of: Callable[[int, Reached], ViewImages | None]
    ) -> ScanStore:
        """Create the scan store; after an error, it is not complete.

        Args:
            path: path of the store.
            folder: existing folder of the run, for the views of a scan of another tool.
            frames_of: returns the images of a view that ``detector.keep`` requests, given its
                index and the state of the robots; no recording contains them.

        Raises:
            InputError: an image is invalid.
            ScanExistsError: the store already exists.
            StorageError: the store cannot be written.
        """
        if self.digests is None:
            with storage_errors(folder):
                panel = self.scenario.detector.panel
                write_views(folder / VIEWS_FILE, self.commanded.geometry(panel))
        any_ = next(iter(self.reached.values()))
        robots = any_.joint_names, len(any_.state), self.plan
        # Images of other software did not pass our imaging chain, so their mAs do not matter.
        mas = None if self.digests is None else SimulationBuilder(self.scenario, self.plan).mas
        more = {"digests": self.digests, "mas": mas}
        store = ScanStore.create(path, self.scenario, self.commanded, *robots, **more)
        try:
            for stamp, pixels in self.contents.images(self.reached):
                index = self.views[stamp]
                reached = self.reached[stamp]
                store.write(index, pixels, reached, frames_of(index, reached))
        except (InputError, ValueError) as error:
            raise InputError(f"{self.contents.names}: {error}") from None
        return store


def read_recordings(paths: Sequence[Path], out: Path) -> RecoveredScan:
    """Read the recordings of one scan, by twinct or by other software with the same topics.

    Args:
        paths: paths of the files, in any order.
        out: future folder of the scan; nothing is written.

    Raises:
        InputError: a file is no recording, or no view is complete.
    """
    contents = Contents.of(paths)
    if contents.facts:
        recorded = _own(contents)
    else:
        recorded = RecoveredScan(contents, *foreign_scan(contents, out / VIEWS_FILE))
    if not recorded.reached:
        problems = "; ".join(
            ("no view is complete, so there is nothing to import", *contents.problems)
        )
        raise InputError(f"{contents.names}: {problems}")
    return recorded


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
    views = {stamp: views[stamp] for stamp in reached}
    digests = {"images": contents.facts["images"]}
    missing = tuple(sorted(set(range(len(commanded))) - set(views.values())))
    return RecoveredScan(contents, scenario, commanded, reached, views, missing, plan, digests)
