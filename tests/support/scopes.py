"""Order of the test files, and their distribution to the workers of xdist."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from xdist.scheduler import LoadFileScheduling

if TYPE_CHECKING:
    from xdist.workermanage import WorkerController

TOGETHER = {"cluster": "pools", "workers": "pools", "study": "pools"}
"""Folders that share a worker: of pools of processes, one at a time is enough for a machine."""

FIRST = (
    "pools",
    "test_trials.py",
    "test_browser.py",
    "test_extensions.py",
    "test_same_bytes.py",
    "test_fuzz.py",
)
"""Scopes that take longest: they start first, so that no worker works alone at the end."""

LAST = "RTK"
"""Scope of the tests that load RTK. One worker loads it, which takes 10 s, and loads it last:
gVXR aborted once after it."""

_RTK = re.compile(r"/test_rtk\.py::|::test_(\w+_)?rtk(_\w+)?$")


def scope_of(nodeid: str) -> str:
    """Return the scope of a test: those of one scope run in one worker."""
    if _RTK.search(nodeid):
        return LAST
    file = nodeid.partition("::")[0]
    return next((TOGETHER[part] for part in Path(file).parts if part in TOGETHER), file)


class Scopes(LoadFileScheduling):
    """Give each file to one worker, and all files that start pools, or Ray, to one of them.

    So three crowds of processes at most run at once with three workers: a pool or Ray, and scans
    over ROS 2 or commands.
    """

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid)

    def _assign_work_unit(self, node: WorkerController) -> None:
        waiting = {Path(scope).name: scope for scope in self.workqueue}
        if first := next((waiting[name] for name in FIRST if name in waiting), None):
            self.workqueue.move_to_end(first, last=False)
        with suppress(OSError):  # it has just crashed: remove_node hands on what it was to do
            super()._assign_work_unit(node)

    def schedule(self) -> None:
        super().schedule()
        if (last := self.workqueue.pop(LAST, None)) is not None:
            self.workqueue[LAST] = last

    def remove_node(self, node: WorkerController) -> str | None:
        """Give what a crashed worker left to others, except for the test that crashed.

        xdist itself also hands out the files that the worker had finished. They send no test, so a
        worker that takes one after its last test waits forever. And xdist runs the test that
        crashed again.
        """
        units = self.assigned_work.pop(node)
        tests = [(unit, test) for unit in units.values() for test, done in unit.items() if not done]
        if not tests:
            return None
        unit, crashed = tests[0]
        unit[crashed] = True
        self.workqueue.update(
            {scope: unit for scope, unit in units.items() if not all(unit.values())}
        )
        for other in self.assigned_work:
            self._reschedule(other)
        return crashed

    def _reschedule(self, node: WorkerController) -> None:
        """Give a worker two tests or the end, as it runs a test only if it knows what follows.

        xdist does so for the first workers, but not for those that replace a crashed one.
        """
        if node not in self.registered_collections:  # it still collects
            return
        super()._reschedule(node)
        if self._pending_of(self.assigned_work[node]) < 2:
            super()._reschedule(node)
