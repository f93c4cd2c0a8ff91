"""Input files of scenarios, offered to a pool by their content."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from twinct.core.files.arm_xml import read_arm_xml
from twinct.scenario.digests import content_digest
from twinct.workers import Pool


class Inputs:
    """Input files of a study's scenarios, each offered once.

    Args:
        folder: folder in which the files of one arm's description are collected.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[Path, tuple[str, str]] = {}

    def offered(self, files: Mapping[str, Path], pool: Pool) -> Mapping[str, tuple[str, str]]:
        """Offer a scenario's files, by key; return offered name and path inside the offer, by key.

        Raises:
            OSError: a file cannot be read.
        """
        offers: dict[str, tuple[str, str]] = {}
        for key, path in files.items():
            if path not in self._known:
                last = key.rpartition(".")[2]
                name = f"{content_digest(path, last)[:32]}-{path.name}"
                whole, inner = self._arm(path, name) if last == "file" else (path, "")
                pool.offer(name, whole)
                self._known[path] = name, inner
            offers[key] = self._known[path]
        return offers

    def _arm(self, path: Path, name: str) -> tuple[Path, str]:
        """Collect an arm's description and its includes; return their folder and its main file."""
        files = [file.absolute() for file in read_arm_xml(path, str(path)).files]
        common = Path(os.path.commonpath([file.parent for file in files]))
        folder = self._folder / name
        for file in files:
            target = folder / file.relative_to(common)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        return folder, str(files[0].relative_to(common))
