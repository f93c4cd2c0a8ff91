"""The whole run of a draft, in a worker: the folder and the stages of ``twinct run``."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import ClassVar

from twinct.core.errors import InputError
from twinct.design.bench import Bench
from twinct.design.questions import Question
from twinct.runs import Folder, run
from twinct.runs.acquisition import Link
from twinct.scan import ScanStore, image_digests
from twinct.scenario import Scenario


@dataclass(frozen=True)
class WholeRun(Question):
    """The run of a state of the scenario, from the plan to the report.

    Attributes:
        out: folder of the run; intact views in it are not taken again.
        link: as of ``twinct.run``.
    """

    out: Path = Path()
    link: Link | None = None
    subject: ClassVar[str] = "run"

    def answered(self, bench: Bench) -> Path:
        """Return the report of the finished run.

        Raises:
            TwinctError: as ``twinct.run``; every acquired view is stored.
        """
        bench.close()  # gVXR is a scene of the process
        scenario = bench.scenario(self.source)
        resume = Folder(self.out).scan.exists()
        done = run(scenario, self.out, link=self.link, resume=resume, observers=bench.observers)
        return done.paths.report


def folder_of(file: Path, scenario: Scenario) -> Path:
    """Return the folder for the run of a state: ``out/NAME``, or a numbered one.

    It is one that does not exist yet, or one with views of this state, which are used again.
    """
    for number in count(1):
        folder = file.parent / "out" / f"{file.stem}{f'-{number}' if number > 1 else ''}"
        if not folder.exists() or _is_of(Folder(folder), scenario):
            return folder
    raise AssertionError


def _is_of(folder: Folder, scenario: Scenario) -> bool:
    """Return True if a folder holds views that a run of a scenario would use."""
    if not folder.scan.is_dir():
        return False
    try:
        ScanStore(folder.scan).refuse_other(image_digests(scenario))
    except InputError:
        return False
    return True
