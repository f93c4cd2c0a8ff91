"""A pool of processes on this machine."""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from typing import Self

from twinct.errors import InputError, MemoryShortageError
from twinct.files.writing import storage_errors
from twinct.memory import available_bytes
from twinct.pool.call import Outcome, event, sent
from twinct.pool.parcel import Here
from twinct.pool.work import Died, Event, Work
from twinct.threads import SETTING

MOST_PASSED = 16
"""Pieces of work that may start before the first in line, while that waits for memory."""


@dataclass(frozen=True)
class _Task:
    key: str
    memory_bytes: int
    message: bytes


class _Worker:
    """A process, and what it is doing."""

    def __init__(self, number: int, folder: Path, threads: int) -> None:
        self.number = number
        self.task: _Task | None = None
        self.connection, theirs = Pipe()
        read, self._lifeline = os.pipe()
        log = folder / "logs" / f"worker-{number}.log"
        inherited = (theirs.fileno(), read)
        # -P: modules are those that this process would import, not those of the current folder.
        program = [sys.executable, "-P", "-u", "-X", "faulthandler", "-m", "twinct.pool.worker"]
        try:
            with storage_errors(log):
                log.parent.mkdir(parents=True, exist_ok=True)
                with log.open("ab") as output:
                    self._process = subprocess.Popen(
                        [*program, *map(str, inherited), str(threads), str(folder)],
                        stdin=subprocess.DEVNULL,
                        stdout=output,
                        stderr=output,
                        pass_fds=inherited,
                        process_group=0,
                        env={
                            **os.environ,
                            SETTING: str(threads),
                            "PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path),
                        },
                    )
        except BaseException:
            self.connection.close()
            os.close(self._lifeline)
            raise
        finally:
            theirs.close()
            os.close(read)

    @property
    def alive(self) -> bool:
        """Whether it can be given work."""
        # It stays unreaped: as long as it is, its number is no other process's, nor its group's.
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self._process.pid, options) is None

    def resident_bytes(self) -> int:
        """Memory that it holds."""
        try:
            pages = Path(f"/proc/{self._process.pid}/statm").read_text(encoding="ascii").split()[1]
        except (OSError, IndexError):  # it is no more
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def end(self) -> str:
        """Kill it, unless it is dead, and all that it started in its group; how it ended."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        code = self._process.wait()
        self.connection.close()
        os.close(self._lifeline)
        return f"ended with code {code}" if code >= 0 else f"was ended by {_name(-code)}"


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


class LocalPool:
    """Processes of this machine, started when there is work for them; see ``twinct.pool.Pool``.

    One thread at a time may use it. Work starts in the order of submission; while the first in line
    waits for memory, others that fit may pass it, at most 16 of them. Idle workers stay warm unless
    running work may need the memory that they hold. The kernel kills the workers when this process
    ends, however it ends.
    """

    def __init__(
        self, folder: Path, *, workers: int, threads: int = 1, memory_bytes: int | None = None
    ) -> None:
        """Nothing is started yet.

        Args:
            folder: where work may keep files; the workers' output goes to ``logs`` in it.
            workers: processes, at most.
            threads: of each of them.
            memory_bytes: of all of them; None for what this process may take now.

        Raises:
            InputError: not at least one worker, thread and byte.
        """
        most = available_bytes()[0] if memory_bytes is None else memory_bytes
        told = {"workers": workers, "threads": threads, "memory_bytes": most}
        if problems := [f"{k}={v}: at least 1 needed" for k, v in told.items() if v < 1]:
            raise InputError(problems)
        self.folder = Path(folder).absolute()
        self._slots, self._threads, self._memory = workers, threads, int(min(most, 2**62))
        self._offered: dict[str, Path] = {}
        self._queue: deque[_Task] = deque()
        self._passed = 0
        self._keys: set[str] = set()
        self._workers: list[_Worker] = []
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def slots(self) -> int:
        """Its processes."""
        return self._slots

    @property
    def most_memory_bytes(self) -> int:
        """All that the pool has."""
        return self._memory

    def offer(self, name: str, path: Path) -> None:
        """Workers get this very path."""
        self._offered[name] = Path(path).absolute()

    def withdraw(self, name: str) -> None:
        """Work that was submitted before keeps it."""
        self._offered.pop(name, None)

    def submit(self, work: Work) -> None:
        """See ``twinct.pool.Pool``."""
        request = sent(work)
        if work.memory_bytes > self._memory:
            raise MemoryShortageError(
                f"work {work.key!r} takes {work.memory_bytes / 2**30:.2f} GiB of memory, and the "
                f"pool has {self._memory / 2**30:.2f} GiB"
            )
        if self._closed or work.key in self._keys:
            raise ValueError("the pool is closed" if self._closed else f"{work.key!r}: known")
        if missing := [name for name in work.inputs if name not in self._offered]:
            raise ValueError(f"not offered to the pool: {', '.join(missing)}")
        inputs = {name: self._offered[name] for name in work.inputs}
        self._keys.add(work.key)
        self._queue.append(_Task(work.key, work.memory_bytes, pickle.dumps((request, inputs))))
        self._start_what_fits()

    def wait(self, timeout_s: float | None = None) -> list[Event]:
        """See ``twinct.pool.Pool``."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        events: list[Event] = []
        self._start_what_fits()
        while self._keys and not events:
            left = None if until is None else max(until - time.monotonic(), 0.0)
            ready = wait([worker.connection for worker in self._workers], left)
            for worker in [w for w in self._workers if w.connection in ready]:
                events += self._hear(worker)
            self._start_what_fits()
            if not ready:
                break
        self._keys -= {e.key for e in events}
        return events

    def close(self, *, clear: bool = False) -> None:
        """End all processes; what was under way is not told of any more."""
        self._closed = True
        self._queue.clear()
        self._keys.clear()
        while self._workers:
            self._remove(self._workers[-1])
        if clear:
            shutil.rmtree(self.folder, ignore_errors=True)

    def _start_what_fits(self) -> None:
        while (place := self._next()) is not None:
            task = self._queue[place]
            worker = self._free_worker()
            worker.task = task
            self._make_room()
            with contextlib.suppress(OSError):  # it has died just now, which is heard next
                worker.connection.send_bytes(task.message)
            del self._queue[place]
            self._passed = 0 if place == 0 else self._passed + 1

    def _next(self) -> int | None:
        """Place in the queue of what may start now."""
        running = [worker.task for worker in self._workers if worker.task is not None]
        if len(running) == self._slots:
            return None
        free = self._memory - sum(task.memory_bytes for task in running)
        for place, task in enumerate(self._queue):
            if place > 0 and self._passed >= MOST_PASSED:
                break
            if task.memory_bytes <= free:
                return place
        return None

    def _free_worker(self) -> _Worker:
        """A warm one if there is any."""
        for worker in [w for w in self._workers if w.task is None]:
            if worker.alive:
                return worker
            self._remove(worker)
        number = min(set(range(self._slots)) - {worker.number for worker in self._workers})
        self._workers.append(_Worker(number, self.folder, self._threads))
        return self._workers[-1]

    def _make_room(self) -> None:
        """End idle workers whose memory the running ones may need."""
        idle = [worker for worker in self._workers if worker.task is None]
        tasks = [worker.task for worker in self._workers if worker.task is not None]
        free = self._memory - sum(task.memory_bytes for task in tasks)
        held = {worker: worker.resident_bytes() for worker in idle}
        while held and sum(held.values()) > free:
            largest = max(held, key=held.__getitem__)
            del held[largest]
            self._remove(largest)

    def _remove(self, worker: _Worker) -> str:
        how = worker.end()
        self._workers.remove(worker)
        return how

    def _hear(self, worker: _Worker) -> list[Event]:
        task = worker.task
        try:
            outcome: Outcome = pickle.loads(worker.connection.recv_bytes())
        except (EOFError, OSError):
            how = self._remove(worker)
            return [] if task is None else [Died(task.key, f"its worker {how}")]
        assert task is not None
        worker.task = None
        parcels = {name: Here(path) for name, path in outcome.parcels.items()}
        return [event(task.key, outcome, parcels)]
