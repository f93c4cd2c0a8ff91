"""A process that hangs is noticed, one that works hard is not taken for it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from twinct.ros import pulse
from twinct.ros.processes import NodeProcess

pytestmark = pytest.mark.process

SILENCE_S = 2.0
"""In place of six."""
LONG_S = 2 * SILENCE_S
NOTICED_S = 10.0

NODE = f"""
import ctypes, sys, time
from twinct.ros import pulse
pulse.SILENCE_S = {SILENCE_S}
from twinct.ros.lifeline import Lifeline
line = Lifeline(parent=True, on_end=lambda why: print(why, flush=True))
def busy(seconds):
    "Hold the interpreter in one call, as an engine does that computes."
    start = time.perf_counter()
    sum(range(10**7))
    sum(range(int(10**7 * seconds / (time.perf_counter() - start))))
def asleep(seconds):
    "Hold the interpreter and do nothing, as an engine does that waits for ever."
    ctypes.PyDLL(None).usleep(int(seconds * 1e6))
print("at work", flush=True)
exec(sys.argv[1])
print("done", flush=True)
time.sleep(60)
"""

PARENT = f"""
import os, sys, time
from pathlib import Path
from twinct.ros import pulse
pulse.SILENCE_S = {SILENCE_S}
from twinct.ros.processes import NodeProcess
command = [sys.executable, "-c", {NODE!r}, "pass"]
log = Path(sys.argv[1])
node = NodeProcess("n", command, log, environment=os.environ, beats=True, on_end=lambda _: None)
print(node.pid, flush=True)
time.sleep(60)
"""


@pytest.fixture
def node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], NodeProcess]]:
    """Starts a process that beats and does something."""
    monkeypatch.setattr(pulse, "SILENCE_S", SILENCE_S)
    started: list[NodeProcess] = []

    def start(work: str) -> NodeProcess:
        process = NodeProcess(
            "busy",
            [sys.executable, "-c", NODE, work],
            tmp_path / "log",
            environment=os.environ,
            beats=True,
            on_end=lambda _: None,
        )
        started.append(process)
        until(lambda: "at work" in process.log.read_text())
        return process

    yield start
    for process in started:
        process.stop()


def until(done: Callable[[], object], within_s: float = 30.0) -> None:
    deadline = time.monotonic() + within_s
    while not done():
        assert time.monotonic() < deadline, f"not within {within_s} s"
        time.sleep(0.02)


@pytest.mark.parametrize("work", [f"busy({LONG_S})", f"time.sleep({LONG_S})"])
def test_long_work_is_no_hang(node: Callable[[str], NodeProcess], work: str) -> None:
    process = node(work)
    until(lambda: process.exit_code is not None or "done" in process.log.read_text())
    time.sleep(SILENCE_S / 2)
    assert process.exit_code is None, process.describe_end()


@pytest.mark.parametrize("work", ["asleep(60)", "time.sleep(60)"])
def test_who_neither_beats_nor_works_is_ended(
    node: Callable[[str], NodeProcess], work: str
) -> None:
    process = node(work)
    if work.startswith("time"):
        os.kill(process.pid, signal.SIGSTOP)
    until(lambda: process.exit_code is not None, NOTICED_S)
    assert process.exit_code == -signal.SIGKILL
    assert "the busy node hung, or was stopped: nothing was heard" in process.describe_end()


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[int, int, Path]]:
    """Process ids of a parent and its node, and the node's log."""
    log = tmp_path / "log"
    with subprocess.Popen(
        [sys.executable, "-c", PARENT, str(log)], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        try:
            child = int(parent.stdout.readline())
            until(lambda: "done" in log.read_text())
            yield parent.pid, child, log
        finally:
            parent.kill()


def test_a_node_ends_when_its_parent_is_stopped(
    pair: tuple[int, int, Path], gone: Callable[..., bool]
) -> None:
    parent, child, log = pair
    os.kill(parent, signal.SIGSTOP)
    assert gone([child], NOTICED_S)
    assert (
        f"nothing was heard for {SILENCE_S:.0f} s of the process that started it" in log.read_text()
    )


def test_all_that_are_stopped_together_go_on_together(
    pair: tuple[int, int, Path], gone: Callable[..., bool]
) -> None:
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for pid in pair[:2]:
            os.kill(pid, number)
        time.sleep(1.5 * SILENCE_S)
    assert not gone(list(pair[:2]), 0.0)


@pytest.mark.parametrize(
    ("states", "heard_before", "lives"),
    [
        ("SSRS", True, True),  # works, or waits for a processor that others have
        ("SDS", True, True),  # waits for a disk
        ("SSS", True, False),
        ("SSS", False, True),  # starts: waits for a process of its own
        ("TTT", False, False),
        ("", False, True),  # hidden from us
    ],
)
def test_silence_counts_by_what_the_threads_do(
    monkeypatch: pytest.MonkeyPatch, states: str, heard_before: bool, lives: bool
) -> None:
    one, other = socket.socketpair()
    monkeypatch.setattr(pulse, "_states", lambda pid: set(states))
    with one, other:
        end = pulse.Pulse(one, os.getpid())
        if heard_before:
            other.send(b".")
        assert end.look()
        looks = [end.look() for _ in range(round(pulse.SILENCE_S / pulse.LOOK_S) + 1)]
        assert looks[-1] == lives
        other.send(b".")
        assert end.look()
