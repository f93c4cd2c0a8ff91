"""Workers and drivers that are killed: rows as if nothing had been, and no process left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import pytest
import yaml

from twinct.study import load_results, run_study

from .conftest import SCENARIO

MARK = "TWINCT_STUDY_TEST"
PATIENCE_S = 90.0

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


def workers(mark: str) -> list[int]:
    return [pid for pid, line in alive(mark).items() if "twinct.pool.worker" in line]


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve trials of two scans."""
    reconstruct = {"key": "reconstruction.relaxation", "label": "r", "values": [0.2, 0.4, 0.6]}
    shared = {"key": "source.current_ma", "label": "current", "values": [10, 20]}
    path = tmp_path_factory.mktemp("study") / "study.yaml"
    again = {"number": 2, "key": "uncertainty.seed"}
    told = {"scenario": SCENARIO, "axes": [reconstruct, shared], "repetitions": again}
    told["set"] = {"reconstruction.iterations": 50}  # a trial lasts, so that it can be disturbed
    path.write_text(yaml.safe_dump(told))
    return path


@pytest.fixture(scope="module")
def undisturbed(study: Path, tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    return rows(run_study(study, tmp_path_factory.mktemp("base") / "out", jobs=1).folder.path)


@pytest.fixture
def started(study: Path, tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """A starter of the command in a group of its own; whatever is left is killed in the end."""

    def start(*more: str) -> subprocess.Popen[str]:
        words = ["study", str(study), "--out", str(tmp_path / "out"), "--jobs", "1", *more]
        return subprocess.Popen(
            [sys.executable, "-m", "twinct", *words],
            env=os.environ | {MARK: str(tmp_path)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    yield start
    for pid in alive(str(tmp_path)):
        os.kill(pid, signal.SIGKILL)


def rows(folder: Path) -> pd.DataFrame:
    table = load_results(folder)
    return table[[name for name in table if not name.startswith("seconds.")]]


def ended(out: Path) -> int:
    """Trials that are in the journal."""
    journal = out / "journal.jsonl"
    return journal.read_text().count("\n") if journal.exists() else 0


def test_a_worker_that_is_killed_is_replaced(started, undisturbed, tmp_path) -> None:
    process, out, mark = started(), tmp_path / "out", str(tmp_path)
    killed: set[int] = set()
    for moment in (0, 5):  # before anything is there, and in the middle
        until(lambda n=moment: ended(out) >= n and {*workers(mark)} - killed)
        (pid,) = {*workers(mark)} - killed
        os.kill(pid, signal.SIGKILL)
        killed.add(pid)
    assert process.wait() == 0, process.stderr.read()
    pd.testing.assert_frame_equal(rows(out), undisturbed)
    assert not alive(mark) and not (out / "work").exists()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=lambda number: number.name)
def test_a_driver_that_ends_leaves_no_process_and_its_study_goes_on(
    started, undisturbed, tmp_path, number
) -> None:
    process, out, mark = started(), tmp_path / "out", str(tmp_path)
    until(lambda: ended(out) >= 3 and workers(mark))
    os.kill(process.pid, number)
    said = process.communicate()[1]
    assert process.returncode == (-number if number == signal.SIGKILL else 1)
    assert "Traceback" not in said
    until(lambda: not alive(mark))
    before = ended(out)
    assert 3 <= before < 12
    again = started("--resume")
    assert again.wait() == 0, again.stderr.read()
    pd.testing.assert_frame_equal(rows(out), undisturbed)
    assert ended(out) == 12 and not alive(mark)  # no trial twice
