"""Folder of a study: paths of its files, and its identity."""

from __future__ import annotations

import hashlib
import json
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.folder_paths import Below, names_below
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import check_folder, write_json, write_text
from twinct.core.foreign_text import quoted
from twinct.study import journal, results
from twinct.study.design import Design

FORMAT = "twinct study 1"


@dataclass(frozen=True)
class StudyFolder:
    """Paths of all files of a study.

    Attributes:
        path: the folder.
        study: the study's file, as it was last run.
        identity: name and digest that identify the study.
        journal: a line for each trial that ended.
        results: the table of results, made from the journal.
        page: the results as a web page.
        log: the log, with tracebacks.
        lock: held by the process that runs the study.
        scans: scans that several trials share.
        trials: stored volumes or folders of the trials.
        best: cross-sections of the best trials.
        inputs: descriptions of arms, with all files that they include.
        work: working folder of this machine's workers.
    """

    path: Path
    study = Below("study.yaml")
    identity = Below("study.json")
    journal = Below(journal.NAME)
    results = Below(results.NAME)
    page = Below("study.html")
    log = Below("study.log")
    lock = Below("twinct.lock")
    scans = Below("scans")
    trials = Below("trials")
    best = Below("best")
    inputs = Below("inputs")
    work = Below("work")

    def check(self, design: Design, *, resume: bool) -> None:
        """Check that a study may run in the folder.

        Raises:
            InputError: the folder holds other files, or another study.
            ScanExistsError: the folder holds this study, and ``resume`` is false.
        """
        check_folder(self.path, set(names_below(StudyFolder)))
        if not self.identity.exists():
            return
        identity, there = _identity(design), self._there()
        if {name: there.get(name) for name in identity} != identity:
            what = "keep" if there.get("base") == identity["base"] else "scenario or 'set'"
            raise InputError(
                f"--out {self.path}: the folder holds another study: its {what} differs; "
                "choose another folder"
            )
        if not resume:
            raise ScanExistsError(
                f"{self.path} already holds this study: continue or extend it with --resume"
            )

    @property
    def name(self) -> str:
        """Unique name of the study: the stored one, or else a new one."""
        return self._there()["id"] if self.identity.exists() else uuid.uuid4().hex[:12]

    def claim(self, design: Design, name: str) -> None:
        """Write the study's identity and file; call ``check`` first."""
        if not self.identity.exists():
            data = {**_identity(design), "id": name, "name": design.study.name}
            write_json(self.identity, data)
        write_text(self.study, design.text)

    def _there(self) -> dict[str, Any]:
        try:
            data = read_json(self.identity)
            if data["format"] != FORMAT:
                raise ValueError(
                    f"format {quoted(data['format'])}; this version of twinct reads {FORMAT!r}"
                )
            return data
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{self.identity}: not a study: {error}") from None


def _identity(design: Design) -> dict[str, Any]:
    """Return the parts that must not change: the scenario before variation, and ``keep``."""
    data = {k: v for k, v in design.template.data.items() if k not in ("name", "description")}
    base = hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()
    return {"format": FORMAT, "base": base, "keep": design.study.keep}
