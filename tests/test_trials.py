"""tools/trials: what a fault leaves behind is found; commands of twinct leave nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.link.recording.bag import Bag
from twinct.link.recording.drive_file import NOTE, OUTCOME
from twinct.link.recording.recorder import PLAN

TOOL = Path(__file__).parents[1] / "tools" / "trials"

sys.path.append(str(TOOL))
from recordings import is_part, told_by  # noqa: E402 - a module of the tool

FAKE = """
import os, pathlib, sys
careful = {careful}
to_come = not os.environ.get("TWINCT_TRIAL", "any").startswith("any")
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
draft, results = out / ".reach.json.partial", out / "reach.json"
try:
    draft.write_text("some numbers")
    import twinct.cli.commands  # from here on, moments count
    for _ in range(50):
        draft.write_text("some numbers")
    while to_come:
        draft.write_text("some numbers")
    draft.rename(results)
except KeyboardInterrupt:
    if not careful:
        results.write_text("some")
        sys.exit(1)
    draft.unlink(missing_ok=True)
    sys.stderr.write("interrupted: nothing is kept\\n")
    sys.exit(130)
"""
"""A program in the place of twinct, which makes one file, and is careful when it is interrupted."""


def trials(*words: str, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = os.environ | ({"PYTHONPATH": str(path)} if path else {})
    command = [sys.executable, str(TOOL), *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@pytest.mark.process
@pytest.mark.parametrize("careful", [True, False])
def test_what_a_fault_leaves_behind_is_found(tmp_path: Path, careful: bool) -> None:
    program = tmp_path / "twinct" / "__main__.py"
    program.parent.mkdir()
    program.write_text(FAKE.format(careful=careful))
    (program.parent / "cli").mkdir()
    for module in ("__init__.py", "cli/__init__.py", "cli/commands.py"):
        (program.parent / module).touch()
    words = ("--trials", "1", "--commands", "reach", "--faults", "Ctrl-C", "--seed", "1")
    words = (*words, "--journal", str(tmp_path / "trials.jsonl"))
    done = trials(*words, path=tmp_path)
    assert done.returncode == (0 if careful else 1), done.stdout + done.stderr
    told = ["exit code 1", "neither as before nor complete", "left behind: .reach.json.partial"]
    for wrong in (*told, "again: python tools/trials"):
        assert (wrong in done.stdout) is not careful, done.stdout
    assert f"{int(careful)} of 1 passed; 0 were drawn again" in done.stdout
    if careful:
        (program.parent / "__main__.py").write_text("1 / 0")
        assert trials(*words, path=tmp_path).stdout == done.stdout  # all of it by the journal


def test_a_part_of_a_recording_says_nothing_else(tmp_path: Path) -> None:
    file = tmp_path / "drive.mcap"
    bag = Bag(file, 100)
    bag.note(NOTE, {"joints": "[]"})
    bag.attach(PLAN, b"plan")
    part = file.read_bytes()
    bag.note(OUTCOME, {"ended": "all controllers succeeded", "start_ns": "1"})
    bag.close()
    whole = told_by(file)
    assert whole == {
        "topics": [],
        "names": {"joints": "[]"},
        PLAN: b"plan",
        "ended": "all controllers succeeded",
        "sent": True,
    }
    assert not is_part(whole, whole)
    for cut in (b"", part, part[:-1]):
        file.write_bytes(cut)
        assert is_part(told_by(file), whole)
    file.write_bytes(b"no recording")
    assert not is_part(told_by(file), whole)
    assert not is_part({"topics": ["/other"]}, whole)
    assert not is_part({"topics": [], PLAN: b"another"}, whole)


@pytest.mark.tutorial
@pytest.mark.process
def test_a_run_withstands_some_faults() -> None:
    """Many more of them: make trials."""
    faults = ("SIGKILL", "Ctrl-C", "64 descriptors")
    done = trials("--trials", "3", "--commands", "run", "--seed", "3", "--faults", *faults)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 of 3 passed" in done.stdout
    assert "exit code [-9]" in done.stdout and "exit code [130]" in done.stdout


@pytest.mark.cluster
@pytest.mark.process
def test_a_study_withstands_the_death_of_a_node() -> None:
    """Workers and drivers die in ``cluster`` and ``study``."""
    words = ("--trials", "1", "--seed", "1", "--commands", "study on a cluster", "--faults")
    done = trials(*words, "a node of a cluster killed")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 of 1 passed" in done.stdout
