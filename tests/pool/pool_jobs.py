"""What the workers of the tests do; pools import it by name."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

from twinct.errors import InputError, MotionError
from twinct.pool import Made, Place


def double(argument: Any, place: Place) -> Any:
    return 2 * argument


def who(argument: Any, place: Place) -> dict[str, Any]:
    import threading

    time.sleep(argument or 0)
    return {
        "process": os.getpid(),
        "main": threading.current_thread() is threading.main_thread(),
        "threads": (place.threads, os.environ["TWINCT_THREADS"], os.environ["OMP_NUM_THREADS"]),
        "folder": place.folder,
    }


def interval(seconds: float, place: Place) -> tuple[float, float]:
    begun = time.monotonic()
    time.sleep(seconds)
    return begun, time.monotonic()


_kept: list[bytes] = []


def grow(number: int, place: Place) -> int:
    """Take bytes and keep them."""
    _kept.append(b"x" * number)
    time.sleep(0.3)
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
        return Made(1, {"nothing": place.folder / "nothing"})
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
    child = subprocess.Popen(["sleep", "60"])
    argument.write_text(str(child.pid))
    os._exit(7)


def hold(seconds: float, place: Place) -> None:
    """Stay in C with the interpreter held, and have a child: no other thread runs."""
    child = subprocess.Popen(["sleep", str(seconds)])
    (place.folder / f".held-{os.getpid()}").write_text(str(child.pid))
    (place.folder / f".held-{os.getpid()}").rename(place.folder / f"held-{os.getpid()}")
    ctypes.PyDLL(None).sleep(int(seconds))


def write(argument: str, place: Place) -> Made:
    """A file and a folder."""
    time.sleep(0.3)
    folder = place.folder / f"made-{argument}"
    (folder / "deep").mkdir(parents=True, exist_ok=True)
    (folder / "deep" / "a.txt").write_text(argument)
    (folder / "b.txt").write_text(2 * argument)
    return Made(argument, {"folder": folder, "file": folder / "b.txt"})


def read(argument: str, place: Place) -> tuple[str, str]:
    """Path and content of what was offered: a file, or a folder with one file."""
    path = place.fetch(argument)
    file = next(path.iterdir()) if path.is_dir() else path
    return str(path), file.read_text()
