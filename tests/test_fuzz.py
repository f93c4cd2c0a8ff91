"""tools/fuzz: what a case may do wrong is found, kept and told; what it may do is not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import HANG_S

FUZZ = Path(__file__).parents[1] / "tools" / "fuzz"

sys.path.append(str(FUZZ))
from hanging import Activity, Watch, activity_of  # noqa: E402 - a module of the tool

KIND = """
import os, signal
from pathlib import Path
from cases import Case
from twinct.core.errors import InputError

def refused():
    raise InputError("no")

def wrong():
    raise KeyError("bug")

def blocked():
    Path("blocked").write_text(str(os.getpid()))
    while True:
        signal.pause()

ACTS = [
    lambda: "right", refused, wrong, lambda: "late", lambda: os._exit(3), blocked,
    lambda: str(len(b"x" * 2**28)), lambda: "right",
]

class Kind:
    seconds, memory_bytes = 1e6, 200 * 2**20

    def __init__(self, material):
        self.counter = material / "counter"

    def case(self, rng, folder):
        number = int(self.counter.read_text()) if self.counter.exists() else 0
        self.counter.write_text(str(number + 1))
        (folder / "input").write_text(str(number))
        self.seconds = 0.0 if number == 3 else 1e6  # any time is more than none
        return Case(f"act {number}", ACTS[number])
"""


DRIVER = """
import math, sys
from pathlib import Path
from driver import fuzz
from hanging import Activity, Limits

place = Path(sys.argv[1])

def activity(pid):  # only the worker that is blocked wants nothing
    blocked = place / "blocked"
    return Activity(0.0, not blocked.exists() or int(blocked.read_text() or 0) != pid)

limits = Limits(idle_looks=3, look_s=0.01)
found = fuzz("mischief", 5, range(8), math.inf, place, limits, activity)
print(sorted(found.words.items()), len(found.failures))
"""


@pytest.mark.process
def test_each_way_to_fail_is_found_and_kept(tmp_path: Path) -> None:
    (tmp_path / "mischief.py").write_text(KIND)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(FUZZ)])}
    result = subprocess.run(
        [sys.executable, "-c", DRIVER, str(tmp_path / "out")],
        capture_output=True,
        text=True,
        env=environment,
        timeout=HANG_S,
    )
    assert result.returncode == 0, result.stderr
    told = result.stdout.splitlines()[-1]
    words = {"KeyError", "MemoryError", "died (3)", "hung", "refused", "too slow"}
    assert told == f"{sorted([*((word, 1) for word in words), ('right', 2)])} 5"
    kept = {path.parent.name: path.read_text() for path in tmp_path.glob("out/5-*/failure.txt")}
    assert set(kept) == {"5-2", "5-3", "5-4", "5-5", "5-6"}
    assert "act 2" in kept["5-2"] and "KeyError: 'bug'" in kept["5-2"]
    assert (tmp_path / "out" / "5-4" / "input").read_text() == "4"


def test_who_uses_the_processor_may_be_slow_but_not_endless() -> None:
    used = 100.0
    watch = Watch(1, 7.0, 0, lambda pid: Activity(used, True))
    said = []
    for used in (101.0, 104.0, 107.0, 107.1):  # noqa: B007 - the watch sees it
        said.append(watch.hangs())
    assert said == [False, False, False, True]


def test_who_waits_for_a_processor_never_hangs() -> None:
    watch = Watch(1, 7.0, 2, lambda pid: Activity(100.0, True))
    assert not any(watch.hangs() for _ in range(10_000))


def test_who_is_blocked_at_several_looks_in_a_row_hangs() -> None:
    now = Activity(100.0, False)
    watch = Watch(1, 7.0, 2, lambda pid: now)
    assert not watch.hangs() and not watch.hangs()
    now = Activity(100.1, False)  # it did something
    assert not watch.hangs()
    assert [watch.hangs() for _ in range(3)] == [False, False, True]


@pytest.mark.process
def test_a_process_that_waits_for_input_wants_nothing() -> None:
    """It may still be starting at the first looks."""
    waits = "import sys; print('ready', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", waits], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"ready\n"
            while activity_of(process.pid).wants_to_run:
                pass
            assert activity_of(os.getpid()).wants_to_run  # this one runs
        finally:
            process.kill()


@pytest.mark.clock
@pytest.mark.process
def test_processor_time_of_children_counts_while_they_live_and_after(tmp_path: Path) -> None:
    """A process with a child that has ended and one that lives; each has used 0.2 s."""
    burn = """
import hashlib, resource, subprocess, sys

def used():
    own = resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_utime + own.ru_stime

while used() < 0.2:
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10_000)
if not sys.argv[1:]:
    subprocess.run([sys.executable, __file__, "ends"])
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    child = subprocess.Popen([sys.executable, __file__, "stays"], **pipes)
    child.stdout.readline()
if sys.argv[1:] != ["ends"]:
    print("burnt", flush=True)
    sys.stdin.read()
"""
    (tmp_path / "burn.py").write_text(burn)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "burn.py")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == "burnt\n"
            floors_s = 6 * 0.01  # six numbers are rounded down to ticks
            assert activity_of(process.pid).used_s > 3 * 0.2 - floors_s
        finally:
            process.kill()


@pytest.mark.process
@pytest.mark.parametrize(
    "kind",
    [
        "scenarios",
        *(pytest.param(kind, marks=pytest.mark.tutorial) for kind in ("files", "stores")),
    ],
)
def test_a_few_cases_of_each_kind(tmp_path: Path, kind: str) -> None:
    cases = ["--count", "25", "--seed", "3", "--any-speed", "--out", str(tmp_path)]
    # It ends a worker that hangs, and then itself.
    result = subprocess.run(
        [sys.executable, str(FUZZ), kind, *cases], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert f"{kind}, seed 3: 25 cases" in result.stdout and "0 failures" in result.stdout
