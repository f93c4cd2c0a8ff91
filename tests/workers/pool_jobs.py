"""What the workers of the tests do; pools import it by name."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, MotionError
from twinct.workers import Place


@dataclass(frozen=True)
class Gate:
    """Holds work until the test opens it; each piece of work says that it has come.

    It is a named pipe: to open it for reading blocks until somebody has it open for writing.
    """

    folder: Path

    @property
    def come(self) -> set[str]:
        """Who has come to the gate, whether it is open or not."""
        return {path.name for path in (self.folder / "come").iterdir()}

    def pass_through(self, name: str) -> None:
        """Say who comes, then wait until the gate is open."""
        (self.folder / "come" / name).write_text(str(os.getpid()))
        os.close(os.open(self.folder / "pipe", os.O_RDONLY))

    def open(self) -> None:
        """Let everybody through, now and later."""
        _writers[self.folder] = os.open(self.folder / "pipe", os.O_RDWR)


_writers: dict[Path, int] = {}


@contextlib.contextmanager
def gate_at(folder: Path) -> Iterator[Gate]:
    """A closed gate. Its end lets everybody through who still waits."""
    (folder / "come").mkdir(parents=True)
    os.mkfifo(folder / "pipe")
    gate = Gate(folder)
    try:
        yield gate
    finally:
        if folder not in _writers:
            gate.open()
        os.close(_writers.pop(folder))


Function = Callable[[Any, Place], Any]


def gated(argument: tuple[Gate, str, Function, Any], place: Place) -> Any:
    """Another job, once the gate is open; the second part is the name to say at it."""
    gate, name, function, inner = argument
    gate.pass_through(name)
    return function(inner, place)


def meet(argument: tuple[Path, str, Any], place: Place) -> Any:
    """Return a value; with a mode, first wait for the other one at a named pipe."""
    pipe, mode, value = argument
    if mode:
        open(pipe, mode).close()
    return value


def double(argument: Any, place: Place) -> Any:
    return 2 * argument


def who(argument: Any, place: Place) -> dict[str, Any]:
    import threading

    return {
        "process": os.getpid(),
        "main": threading.current_thread() is threading.main_thread(),
        "threads": (place.threads, os.environ["TWINCT_THREADS"], os.environ["OMP_NUM_THREADS"]),
        "folder": place.folder,
    }


_kept: list[bytes] = []


def grow(number: int, place: Place) -> int:
    """Take bytes and keep them."""
    _kept.append(b"x" * number)
    return os.getpid()


class Sealed(Exception):
    """Cannot be pickled."""

    def __reduce__(self) -> str:
        raise TypeError("sealed")


def fail(kind: str, place: Place) -> Any:
    if kind == "input":
        raise InputError(["one", "two"])
    if kind == "meant":
        raise MotionError("arms stand still")
    if kind == "sealed":
        raise Sealed("by whom")
    if kind == "result":
        return lambda: None
    if kind == "exit":
        raise SystemExit(3)
    if kind == "missing":
        place.attach("nothing", place.folder / "nothing")
        return 1
    raise RuntimeError(kind)


def die_until(argument: tuple[Path, int], place: Place) -> int:
    """Kill its worker the first so many times."""
    path, times = argument
    count = len(path.read_text()) if path.exists() else 0
    if count < times:
        path.write_text("x" * (count + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return count


def leave(argument: Path, place: Place) -> None:
    """Start a process that outlives a worker, say so, and die."""
    child = subprocess.Popen(["sleep", "infinity"])
    argument.write_text(str(child.pid))
    os._exit(7)


def hold(argument: None, place: Place) -> None:
    """Stay in C for ever with the interpreter held, and have a child: no other thread runs."""
    child = subprocess.Popen(["sleep", "infinity"])
    (place.folder / f".held-{os.getpid()}").write_text(str(child.pid))
    (place.folder / f".held-{os.getpid()}").rename(place.folder / f"held-{os.getpid()}")
    while True:
        ctypes.PyDLL(None).pause()


def write(argument: str, place: Place) -> str:
    """A file and a folder."""
    folder = place.folder / f"made-{argument}"
    (folder / "deep").mkdir(parents=True, exist_ok=True)
    (folder / "deep" / "a.txt").write_text(argument)
    (folder / "b.txt").write_text(2 * argument)
    place.attach("folder", folder)
    place.attach("file", folder / "b.txt")
    return argument


def read(argument: str, place: Place) -> tuple[str, str]:
    """Path and content of what was offered: a file, or a folder with one file."""
    path = place.fetch(argument)
    file = next(path.iterdir()) if path.is_dir() else path
    return str(path), file.read_text()
