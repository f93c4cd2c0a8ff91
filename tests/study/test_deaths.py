"""Workers and drivers that are killed: rows as if nothing had been, and no process left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import yaml
from waiting import HANG_S, until

from twinct.study import load_results

from .conftest import SCENARIO

MARK = "TWINCT_STUDY_TEST"

PATIENT = """
import os
from typing import Literal

from twinct.recon.algorithm import Algorithm, solve_by
from twinct.recon.sart import Sart, sart


class Patient(Sart):
    algorithm: Literal["patient"] = "patient"


def _solve(problem, settings):
    folder = os.environ["TWINCT_STUDY_TEST"]
    with open(f"{folder}/begun", "a") as begun:
        begun.write(f"{os.getpid()}\\n")
    turns = os.open(f"{folder}/turns", os.O_RDWR)
    os.read(turns, 1)
    os.close(turns)
    return solve_by(sart, problem, settings)


PATIENT = Algorithm(Patient, _solve, volumes=3, projections=1)
"""
"""SART that says who begins, and then waits for its turn: a byte in a named pipe."""

pytestmark = [pytest.mark.process, pytest.mark.tutorial]


def alive(mark: str) -> dict[int, str]:
    """Processes that have the mark: number and command line."""
    found: dict[int, str] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes().split(b"\0")
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if f"{MARK}={mark}".encode() in environment and any(words):
            found[int(folder.name)] = b" ".join(words).decode()
    return found


class Command:
    """The command on the study, in a folder of its own; reconstructions wait for their turns.

    Attributes:
        out: the study's folder.
        mark: that all its processes have.
    """

    def __init__(self, study: Path, folder: Path) -> None:
        self.out, self.mark = folder / "out", str(folder)
        self._words = ["study", str(study), "--out", str(self.out), "--jobs", "1"]
        self._path = os.pathsep.join(filter(None, [str(study.parent), os.getenv("PYTHONPATH")]))
        self._begun, turns = folder / "begun", folder / "turns"
        self._begun.touch()
        os.mkfifo(turns)
        self._turns = os.open(turns, os.O_RDWR)

    def start(self, *more: str) -> subprocess.Popen[str]:
        """The command, in a group of its own."""
        return subprocess.Popen(
            [sys.executable, "-m", "twinct", *self._words, *more],
            env=os.environ | {MARK: self.mark, "PYTHONPATH": self._path},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def let(self, reconstructions: int) -> None:
        """Let so many go on, one after the other."""
        os.write(self._turns, b"x" * reconstructions)

    def at_work(self, reconstructions: int, rows: int) -> int:
        """Wait until so many have begun and so many rows are there; the last one's worker."""

        def there() -> list[str]:
            begun = self._begun.read_text().splitlines()
            return begun if len(begun) >= reconstructions and self.ended >= rows else []

        begun = until(there, f"reconstruction {reconstructions} after {rows} rows")
        assert (len(begun), self.ended) == (reconstructions, rows)
        return int(begun[-1])

    @property
    def ended(self) -> int:
        """Trials that are in the journal."""
        journal = self.out / "journal.jsonl"
        return journal.read_text().count("\n") if journal.exists() else 0

    def close(self) -> None:
        """Kill whatever is left."""
        for pid in alive(self.mark):
            os.kill(pid, signal.SIGKILL)
        os.close(self._turns)


def succeeds(process: subprocess.Popen[str]) -> None:
    said = process.communicate(timeout=HANG_S)[1]
    assert process.returncode == 0, said


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight trials of two scans; beside it the algorithm, as an installer leaves it."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "patient.py").write_text(PATIENT)
    info = folder / "patient-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: patient\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[twinct.algorithms]\npatient = patient:PATIENT\n")
    reconstruct = {"key": "reconstruction.relaxation", "label": "r", "values": [0.2, 0.6]}
    shared = {"key": "source.current_ma", "label": "current", "values": [10, 20]}
    again = {"number": 2, "key": "uncertainty.seed"}
    told = {"scenario": SCENARIO, "axes": [reconstruct, shared], "repetitions": again}
    told["set"] = {"reconstruction.algorithm": "patient"}
    (folder / "study.yaml").write_text(yaml.safe_dump(told))
    return folder / "study.yaml"


@pytest.fixture(scope="module")
def undisturbed(study: Path, tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    command = Command(study, tmp_path_factory.mktemp("base"))
    try:
        command.let(8)
        succeeds(command.start())
        return rows(command.out)
    finally:
        command.close()


@pytest.fixture
def command(study: Path, tmp_path: Path) -> Iterator[Command]:
    command = Command(study, tmp_path)
    yield command
    command.close()


def rows(folder: Path) -> pd.DataFrame:
    table = load_results(folder)
    return table[[name for name in table if not name.startswith("seconds.")]]


def test_a_worker_that_is_killed_is_replaced(command, undisturbed) -> None:
    process = command.start()
    first = command.at_work(1, rows=0)
    os.kill(first, signal.SIGKILL)  # before anything is there
    second = command.at_work(2, rows=0)
    command.let(5)
    assert command.at_work(7, rows=5) == second
    os.kill(second, signal.SIGKILL)  # in the middle
    assert command.at_work(8, rows=5) not in (first, second)
    command.let(3)
    succeeds(process)
    pd.testing.assert_frame_equal(rows(command.out), undisturbed)
    assert not alive(command.mark) and not (command.out / "work").exists()


def test_drivers_that_end_leave_no_process_and_their_study_goes_on(command, undisturbed) -> None:
    """Kill the first with three rows, interrupt the next with six."""
    begun = 0
    for ended, number, code in ((3, signal.SIGKILL, -signal.SIGKILL), (6, signal.SIGINT, 130)):
        process = command.start(*(["--resume"] if begun else []))
        command.let(3)
        begun += 4  # the last one waits
        command.at_work(begun, rows=ended)
        os.kill(process.pid, number)
        said = process.communicate(timeout=HANG_S)[1]
        assert process.returncode == code
        assert "Traceback" not in said
        assert code < 0 or f"{command.out} keeps {ended} of 8 trials; --resume continues" in said
        until(lambda: not alive(command.mark))
        assert command.ended == ended
    command.let(12)  # more than are needed: it takes none twice
    succeeds(command.start("--resume"))
    pd.testing.assert_frame_equal(rows(command.out), undisturbed)
    assert command.ended == 8 and not alive(command.mark)  # no trial twice
