"""A process that hangs is noticed, one that works hard is not taken for it."""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TextIO

import pytest
from waiting import until

from twinct.link import heartbeat, processes
from twinct.link.processes import NodeProcess

pytestmark = pytest.mark.process

LOOK_S, SILENCE_S = 0.1, 1.0
"""In place of half a second and six."""
LONG = 2 * round(SILENCE_S / LOOK_S)
"""Looks at a process in twice the silence that would end it."""

HASTY = f"""
from twinct.link import heartbeat
heartbeat.LOOK_S, heartbeat.SILENCE_S = {LOOK_S}, {SILENCE_S}
"""

NODE = (
    HASTY
    + """
import ctypes, fcntl, functools, signal, sys
from twinct.link.lifeline import Lifeline
class Noted(heartbeat.Pulse):
    def look(self):
        print("looks", flush=True)
        return super().look()
sys.modules["twinct.link.lifeline"].Pulse = Noted
line = Lifeline(parent=True, on_end=lambda why: print(why, flush=True))
libc = ctypes.PyDLL(None)  # its functions hold the interpreter
gate = open(sys.argv[2])
def busy():
    "Hold the interpreter in one call, as an engine does that computes, until the gate opens."
    try_gate = functools.partial(libc.flock, gate.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
    sum(iter(try_gate, 0))
def idle():
    "Wait for the gate and let others have the interpreter."
    fcntl.flock(gate, fcntl.LOCK_SH)
def asleep():
    "Hold the interpreter and do nothing, as an engine does that waits for ever."
    libc.pause()
print("at work", flush=True)
exec(sys.argv[1])
print("done", flush=True)
signal.pause()
"""
)

PARENT = (
    HASTY
    + f"""
import os, signal, sys
from pathlib import Path
from twinct.link import processes
class Noted(heartbeat.Pulse):
    def look(self):
        print("looks", file=looks, flush=True)
        return super().look()
processes.Pulse = Noted
log, looks = Path(sys.argv[1]), open(sys.argv[2], "w")
command = [sys.executable, "-c", {NODE!r}, "pass", os.devnull]
node = processes.NodeProcess(
    "n", command, log, environment=os.environ, beats=True, on_end=lambda _: None
)
print(node.pid, flush=True)
signal.pause()
"""
)


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """What this process finds whenever it looks at another."""
    found: list[bool] = []
    look = heartbeat.Pulse.look

    def noted(self: heartbeat.Pulse) -> bool:
        found.append(look(self))
        return found[-1]

    monkeypatch.setattr(heartbeat.Pulse, "look", noted)
    return found


@pytest.fixture
def gate(tmp_path: Path) -> Iterator[TextIO]:
    """A file that is locked until a test opens it to all."""
    with (tmp_path / "gate").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield file


@pytest.fixture
def node(
    tmp_path: Path, gate: TextIO, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[str], NodeProcess]]:
    """Starts a process that beats and does something."""
    for module in (heartbeat, processes):
        monkeypatch.setattr(module, "LOOK_S", LOOK_S)
    monkeypatch.setattr(heartbeat, "SILENCE_S", SILENCE_S)
    started: list[NodeProcess] = []

    def start(work: str) -> NodeProcess:
        process = NodeProcess(
            "busy",
            [sys.executable, "-c", NODE, f"{work}()", gate.name],
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
        process._kill()
        process.stop()


@pytest.mark.clock
@pytest.mark.parametrize("work", ["busy", "idle"])
def test_long_work_is_no_hang(
    node: Callable[[str], NodeProcess], gate: TextIO, looks: list[bool], work: str
) -> None:
    process = node(work)

    def looked(times: int) -> None:
        enough = len(looks) + times
        until(lambda: len(looks) >= enough or process.exit_code is not None)
        assert process.exit_code is None and all(looks), process.describe_end()

    looked(LONG)
    assert "done" not in process.log.read_text()
    fcntl.flock(gate, fcntl.LOCK_UN)
    until(lambda: "done" in process.log.read_text() or process.exit_code is not None)
    looked(LONG // 4)


@pytest.mark.parametrize("work", ["asleep", "stopped"])
def test_who_neither_beats_nor_works_is_ended(
    node: Callable[[str], NodeProcess], work: str
) -> None:
    process = node("asleep" if work == "asleep" else "idle")
    if work == "stopped":
        os.kill(process.pid, signal.SIGSTOP)
    until(lambda: process.exit_code is not None)
    assert process.exit_code == -signal.SIGKILL
    assert "the busy node hung or was stopped: it was silent" in process.describe_end()


class Pair(NamedTuple):
    """Process ids of a parent and its node; what the node prints; a line for each parent's look."""

    parent: int
    child: int
    log: Path
    looks: Path


@pytest.fixture
def pair(tmp_path: Path, ended: Callable[[int], bool]) -> Iterator[Pair]:
    """Two processes that look at each other and have nothing else to do."""
    log, looks = tmp_path / "log", tmp_path / "looks"
    with subprocess.Popen(
        [sys.executable, "-c", PARENT, str(log), str(looks)], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = None
        try:
            child = int(parent.stdout.readline())
            until(lambda: "done" in log.read_text())
            yield Pair(parent.pid, child, log, looks)
        finally:
            parent.kill()
            if child is not None and not ended(child):
                with suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)


def test_a_node_ends_when_its_parent_is_stopped(
    pair: Pair, wait_for_end: Callable[[list[int]], None]
) -> None:
    os.kill(pair.parent, signal.SIGSTOP)
    wait_for_end([pair.child])
    told = f"the process that started it was silent for {SILENCE_S:.0f} s"
    assert told in pair.log.read_text()


@pytest.mark.clock
def test_all_that_are_stopped_together_go_on_together(
    pair: Pair, ended: Callable[[int], bool]
) -> None:
    both = pair.parent, pair.child

    def looks() -> int:
        return min(file.read_text().count("looks") for file in (pair.log, pair.looks))

    until(lambda: looks() > 0)
    for pid in both:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(1.5 * SILENCE_S)
    before = looks()
    for pid in both:
        os.kill(pid, signal.SIGCONT)
    until(lambda: looks() > before + LONG or any(map(ended, both)))
    assert not any(map(ended, both)), pair.log.read_text()


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
    monkeypatch.setattr(heartbeat, "_states", lambda pid: set(states))
    with one, other:
        end = heartbeat.Pulse(one, os.getpid())
        if heard_before:
            other.send(b".")
        assert end.look()
        looks = [end.look() for _ in range(round(heartbeat.SILENCE_S / heartbeat.LOOK_S) + 1)]
        assert looks[-1] == lives
        other.send(b".")
        assert end.look()
