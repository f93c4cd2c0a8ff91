"""tools/fuzz: what a case may do wrong is found, kept and told; what it may do is not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[1] / "tools" / "fuzz"

KIND = """
import os, time
from cases import Case
from twinct.errors import InputError

def refused():
    raise InputError("no")

def slow():
    end = time.process_time() + 0.7
    while time.process_time() < end:
        pass
    return "late"

def wrong():
    raise KeyError("bug")

ACTS = [
    lambda: "right", refused, wrong, slow, lambda: os._exit(3), lambda: time.sleep(60) or "x",
    lambda: str(len(b"x" * 2**28)), lambda: "right",
]

class Kind:
    seconds, memory_bytes = 0.5, 200 * 2**20

    def __init__(self, material):
        self.number = 0
        self.counter = material / "counter"

    def case(self, rng, folder):
        number = int(self.counter.read_text()) if self.counter.exists() else 0
        self.counter.write_text(str(number + 1))
        (folder / "input").write_text(str(number))
        return Case(f"act {number}", ACTS[number])
"""


@pytest.mark.process
def test_each_way_to_fail_is_found_and_kept(tmp_path: Path) -> None:
    (tmp_path / "mischief.py").write_text(KIND)
    code = f"""
import sys; sys.path[:0] = [{str(FUZZ)!r}]
from pathlib import Path
from driver import fuzz
found = fuzz("mischief", 5, range(8), 300, Path({str(tmp_path / "out")!r}))
print(sorted(found.words.items()), len(found.failures))
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(FUZZ)])}
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=120
    )
    assert result.returncode == 0, result.stderr
    told = result.stdout.splitlines()[-1]
    for word in ("'KeyError', 1", "'MemoryError', 1", "'died (3)', 1", "'hung', ", "'refused', 1"):
        assert word in told
    # On a machine that is busy enough what is slow cannot be told from what hangs.
    assert "'too slow', 1" in told or "'hung', 2" in told
    assert "'right', 2" in told and told.endswith(" 5")
    kept = {path.parent.name: path.read_text() for path in tmp_path.glob("out/5-*/failure.txt")}
    assert set(kept) == {"5-2", "5-3", "5-4", "5-5", "5-6"}
    assert "act 2" in kept["5-2"] and "KeyError: 'bug'" in kept["5-2"]
    assert (tmp_path / "out" / "5-4" / "input").read_text() == "4"


@pytest.mark.process
def test_a_case_does_not_depend_on_what_ran_before_in_the_folder(tmp_path: Path) -> None:
    code = f"""
import random, sys; sys.path[:0] = [{str(FUZZ)!r}]
from pathlib import Path
from scenario_files import Kind
for turn in range(2):
    kind = Kind(Path({str(tmp_path)!r}))
    print(len(kind._data), kind._values(random.Random(3)))
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert result.returncode == 0, result.stderr
    first, second = result.stdout.splitlines()
    assert first == second


@pytest.mark.process
@pytest.mark.parametrize(
    "kind",
    [
        *("scenarios", "files"),
        pytest.param("stores", marks=pytest.mark.tutorial),  # their scans take a minute
        pytest.param("messages", marks=[pytest.mark.tutorial, pytest.mark.ros]),
    ],
)
def test_a_few_cases_of_each_kind(tmp_path: Path, kind: str) -> None:
    command = [
        sys.executable,
        str(FUZZ),
        kind,
        "--count",
        "25",
        "--seed",
        "3",
        "--out",
        str(tmp_path),
    ]
    result = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stdout + result.stderr
    assert f"{kind}, seed 3: 25 cases" in result.stdout and "0 failures" in result.stdout
