"""Rebuilds a scan store from recordings of the scan, and from nothing else."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from twinct.errors import InputError
from twinct.files.plain_json import json_of
from twinct.files.writing import storage_errors
from twinct.record.contents import Contents
from twinct.record.foreign import foreign_scan
from twinct.record.recorder import COMMANDED, PLAN, SCENARIO
from twinct.scan import NamedGeometry, ScanStore, View, Workshop
from twinct.scenario import Scenario, parse_scenario
from twinct.trajectory import write_views
from twinct.views import PosePairs, Reached

if TYPE_CHECKING:
    from twinct.motion import MotionPlan

VIEWS_FILE = "views.csv"
"""Views of a scan that twinct did not record, beside its store."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A scan as recordings have it.

    Attributes:
        contents: what they hold.
        scenario: of the scan.
        commanded: poses of all views.
        reached: what was reached at the stamp of each view that is complete.
        views: which view each of these stamps is.
        missing: views that the recordings do not hold.
        plan: that the arms followed, if any.
        digests: of the scenario and its files as they were; None where twinct did not make it.
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
        """Missing views, such as ``views 3, 5 to 9``."""
        found = groupby(enumerate(self.missing), lambda pair: pair[1] - pair[0])
        runs = [[view for _, view in run] for _, run in found]
        words = ", ".join(f"{r[0]} to {r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs)
        return f"view {words}" if len(self.missing) == 1 else f"views {words}"

    def rebuild(self, path: Path, whole: Callable[[int, View], View]) -> ScanStore:
        """Make the scan store; it is there whole or not at all.

        Args:
            path: of the store.
            whole: adds to a view, given its index, what no recording has: the frames that the
                scenario's ``detector.keep`` asks for.

        Raises:
            InputError: an image is none.
            ScanExistsError: there is a store already.
            StorageError: it cannot be written.
        """
        if self.digests is None:
            with storage_errors(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                panel = self.scenario.detector.panel
                write_views(path.with_name(VIEWS_FILE), self.commanded.geometry(panel))
        any_ = next(iter(self.reached.values()))
        robots = any_.joint_names, len(any_.state), self.plan
        # A recording of another tool's has no chain of ours, whose mAs would have to be known.
        mas = None if self.digests is None else Workshop(self.scenario, self.plan).mas
        more = {"digests": self.digests, "mas": mas}
        store = ScanStore.create(path, self.scenario, self.commanded, *robots, **more)
        try:
            for stamp, pixels in self.contents.images(self.reached):
                index = self.views[stamp]
                store.write(index, whole(index, View(pixels, self.reached[stamp])))
        except (InputError, ValueError) as error:
            shutil.rmtree(path)
            raise InputError(f"{self.contents.names}: {error}") from None
        return store


def read_recordings(paths: Sequence[Path], out: Path) -> Recorded:
    """Read the recordings of one scan, twinct's own or another tool's of the same topics.

    Args:
        paths: of the files, in any order.
        out: folder that the scan shall have; nothing is written.

    Raises:
        InputError: one is no recording, or there is no complete view in them.
    """
    contents = Contents.of(paths)
    if contents.facts:
        found = _own(contents)
    else:
        found = Recorded(contents, *foreign_scan(contents, out / VIEWS_FILE))
    if not found.reached:
        problems = "; ".join(
            ("no view is complete, so there is nothing to import", *contents.problems)
        )
        raise InputError(f"{contents.names}: {problems}")
    return found


def _own(contents: Contents) -> Recorded:
    if missing := {SCENARIO, COMMANDED} - contents.files.keys():
        raise InputError(
            f"{contents.names}: cut off before {' and '.join(sorted(missing))}, so there is "
            "nothing to import"
        )
    try:
        scenario = parse_scenario(json_of(contents.files[SCENARIO]))
    except ValueError as error:
        raise InputError(f"{contents.names}: {SCENARIO}: no JSON: {error}") from None
    with tempfile.TemporaryDirectory(prefix="twinct-") as name:
        folder = Path(name)
        for file in {COMMANDED, PLAN} & contents.files.keys():
            (folder / file).write_bytes(contents.files[file])
        commanded = NamedGeometry.read(folder / COMMANDED).poses
        plan = None
        if PLAN in contents.files:
            from twinct.motion import load_plan

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
    return Recorded(contents, scenario, commanded, reached, views, missing, plan, digests)
