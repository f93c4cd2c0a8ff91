"""Driver of a worker: it ends the worker if it hangs, and stores the failures."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hanging import Activity, Limits, Watch

CASES_A_WORKER = 20_000
"""Cases per worker; a fresh worker limits the memory that libraries retain from each case."""


@dataclass
class Outcome:
    """Outcome of many cases.

    Attributes:
        words: number of cases with each outcome.
        failures: a line about each failure.
        slowest: processor seconds of the slowest case, and its number.
        largest: largest memory peak of a case, bytes, and its number.
    """

    words: Counter[str] = field(default_factory=Counter[str])
    failures: list[str] = field(default_factory=list[str])
    slowest: tuple[float, int] = (0.0, -1)
    largest: tuple[int, int] = (0, -1)


class Worker:
    """A process that tries cases; it is restarted after each case that ends it."""

    def __init__(
        self,
        kind: str,
        seed: int,
        place: Path,
        limits: Limits,
        activity: Callable[[int], Activity] | None,
        *,
        any_speed: bool,
    ) -> None:
        """Use ``place`` for the material and for the folder of the current case."""
        self.folder = place / "case"
        self._limits, self._activity = limits, activity
        own = [kind, str(seed), str(place), str(self.folder), *(["any-speed"] * any_speed)]
        script = Path(__file__).resolve().with_name("worker.py")
        self._command = [sys.executable, str(script), *own]
        self._process: subprocess.Popen[bytes] | None = None
        self._rest = b""
        self._seconds = 0.0
        self._left = 0

    def __enter__(self) -> Worker:
        """Return the worker; the first case starts it."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the worker."""
        self._end()

    def tried(self, number: int) -> dict[str, Any]:
        """Return the worker's result of a case; its word is ``hung`` or ``died`` without one."""
        if self._process is None or self._left == 0:
            self._start()
        assert self._process is not None and self._process.stdin is not None
        self._left -= 1
        before = time.monotonic()
        self._process.stdin.write(f"{number}\n".encode())
        self._process.stdin.flush()
        line = self._line(self._limits.times * self._seconds)
        if line:
            return json.loads(line)
        code = self._process.poll()
        word = "hung" if code is None else f"died ({code})"
        self._end()
        seconds = time.monotonic() - before
        told = "no answer from the worker; --only shows more"
        return {"word": word, "ok": False, "told": told, "trace": "", "seconds": seconds} | {
            "memory_bytes": 0
        }

    def _start(self) -> None:
        self._end()
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )
        self._rest, self._left = b"", CASES_A_WORKER
        limits = self._line(self._limits.start_s)
        if not limits:
            how = "hangs" if self._process.poll() is None else "ends"
            raise SystemExit(f"the worker {how} at its start: see {self.folder.parent}/worker.log")
        self._seconds = json.loads(limits)["seconds"]

    def _line(self, processor_s: float) -> bytes:
        """Return the next line of the worker; empty if it hangs or has ended."""
        assert self._process is not None and self._process.stdout is not None
        limits = self._limits
        watch = Watch(self._process.pid, processor_s, limits.idle_looks, self._activity)
        while b"\n" not in self._rest:
            if not select.select([self._process.stdout], [], [], limits.look_s)[0]:
                if watch.hangs():
                    return b""
                continue
            chunk = os.read(self._process.stdout.fileno(), 65536)
            if not chunk:
                self._process.wait()
                return b""
            self._rest += chunk
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def fuzz(
    kind: str,
    seed: int,
    numbers: Iterable[int],
    seconds: float,
    place: Path,
    limits: Limits = Limits(),  # noqa: B008 - it is frozen
    activity: Callable[[int], Activity] | None = None,
    *,
    any_speed: bool = False,
) -> Outcome:
    """Try cases until the numbers or the time run out, and store the files of each failure.

    Args:
        kind: name of the module of the kind.
        seed: seed of the cases.
        numbers: numbers of the cases.
        seconds: time after which no new case starts.
        place: folder for files, named after the kind on the command line.
        limits: limits beyond which a worker hangs.
        activity: function that returns the activity of a worker, by its pid.
        any_speed: if True, no case is too slow as long as its worker does not hang.
    """
    found, end, last = Outcome(), time.monotonic() + seconds, time.monotonic()
    with Worker(kind, seed, place, limits, activity, any_speed=any_speed) as worker:
        for number in numbers:
            if time.monotonic() > end:
                break
            told = worker.tried(number)
            found.words[told["word"]] += 1
            found.slowest = max(found.slowest, (told["seconds"], number))
            found.largest = max(found.largest, (told["memory_bytes"], number))
            if not told["ok"]:
                found.failures.append(_kept(told, seed, number, worker.folder, place))
                print(found.failures[-1], flush=True)
            if time.monotonic() > last + 30:
                last = time.monotonic()
                sys.stderr.write(f"{found.words.total()} cases, {len(found.failures)} failures\n")
    return found


def _kept(told: dict[str, Any], seed: int, number: int, folder: Path, place: Path) -> str:
    kept = place / f"{seed}-{number}"
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(folder, kept, symlinks=True, copy_function=_copied)
    words = [f"{told['word']}: {told['told']}", told["trace"].strip().rpartition("\n")[2]]
    (kept / "failure.txt").write_text(f"{words[0]}\n\n{told['trace']}", encoding="utf-8")
    return f"{place.name} --seed {seed} --only {number}: " + " | ".join(
        word[:300] for word in words if word
    )


def _copied(source: str, target: str) -> None:
    """Copy regular files only; pipes and devices have no content to store."""
    if Path(source).is_file():
        shutil.copy2(source, target)
