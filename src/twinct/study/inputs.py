"""Files that scenarios name, offered to a pool by their content."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from twinct.files.arm_xml import read_arm_xml
from twinct.pool import Pool
from twinct.scenario import Scenario
from twinct.scenario.digests import content_digest


class Inputs:
    """What the scenarios of a study name; each content is offered once.

    Args:
        folder: where files are put together that belong to one description of an arm.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[Path, tuple[str, str]] = {}

    def offered(self, scenario: Scenario, pool: Pool) -> Mapping[str, tuple[str, str]]:
        """By key: the name under which a content is offered, and where in it the file is.

        Raises:
            OSError: a file cannot be read.
        """
        found: dict[str, tuple[str, str]] = {}
        for key, path in scenario.files().items():
            if path not in self._known:
                last = key.rpartition(".")[2]
                name = f"{content_digest(path, last)[:32]}-{path.name}"
                whole, inner = self._arm(path, name) if last == "file" else (path, "")
                pool.offer(name, whole)
                self._known[path] = name, inner
            found[key] = self._known[path]
        return found

    def _arm(self, path: Path, name: str) -> tuple[Path, str]:
        """A folder with all that an arm's description includes, and where in it that is."""
        files = [file.absolute() for file in read_arm_xml(path, str(path)).files]
        common = Path(os.path.commonpath([file.parent for file in files]))
        folder = self._folder / name
        for file in files:
            target = folder / file.relative_to(common)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        return folder, str(files[0].relative_to(common))
