"""Stacks of a test process that crashes, for the report at the end of the tests."""

from __future__ import annotations

import faulthandler
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from xdist.workermanage import WorkerController

RUNNERS = ("/_pytest/", "/pluggy/", "/xdist/", "/execnet/", "Extension modules:", '"<string>"')
"""Marks of the lines that every crash has."""


class CrashReport:
    """Let each worker of xdist write its stacks to a file, and the controller report them."""

    _folder: TemporaryDirectory[str] | None = None

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: WorkerController) -> None:
        """Give a worker its file."""
        if self._folder is None:
            self._folder = TemporaryDirectory(prefix="twinct-crashes-")
        node.workerinput["stacks"] = str(Path(self._folder.name, node.gateway.id))

    def pytest_sessionstart(self, session: pytest.Session) -> None:
        """Replace pytest's handler, which writes among the output of all workers."""
        if (given := getattr(session.config, "workerinput", None)) is not None:
            self._stacks = Path(given["stacks"]).open("w")  # open until the process ends
            faulthandler.enable(self._stacks)

    @pytest.hookimpl(optionalhook=True)
    def pytest_handlecrashitem(self, report: Any) -> None:
        """Add the stacks to the report of the test that crashed."""
        with suppress(FileNotFoundError):
            stacks = Path(report.node.workerinput["stacks"]).read_text(errors="replace")
            lines = (line for line in stacks.splitlines() if not any(r in line for r in RUNNERS))
            report.longrepr = "\n".join([str(report.longrepr), *lines])

    def pytest_unconfigure(self) -> None:
        """Remove the folder."""
        if self._folder is not None:
            self._folder.cleanup()
