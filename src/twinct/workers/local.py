"""Pool of processes on this machine."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time
from collections import deque
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path

from twinct.core.errors import InputError
from twinct.core.files.links import no_link
from twinct.core.files.writing import remove_folder, storage_errors
from twinct.core.interruption import postponed
from twinct.core.memory import available_bytes
from twinct.core.threads import SETTING
from twinct.workers.artifact import save_linked
from twinct.workers.call import received
from twinct.workers.pool import Pool
from twinct.workers.work import Died, Done, Event, Failed, Work

MOST_PASSED = 16
"""Number of pieces of work that may overtake the first in line while it waits for memory."""


class _Worker:
    """A worker process and its current task."""

    def __init__(self, number: int, folder: Path, threads: int) -> None:
        self.number = number
        self.task: Work | None = None
        self.connection, theirs = Pipe()
        read, self._lifeline = os.pipe()
        log = folder / "logs" / f"worker-{number}.log"
        inherited = (theirs.fileno(), read)
        # -P: import the same modules as this process, not modules in the current folder.
        program = [sys.executable, "-P", "-u", "-X", "faulthandler", "-m", "twinct.workers.worker"]
        try:
            with storage_errors(log):
                log.parent.mkdir(parents=True, exist_ok=True)
                with open(log, "ab", opener=no_link) as output:
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
        """True if the process can take work."""
        # WNOWAIT leaves it unreaped, so that no other process or group can get its number.
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self._process.pid, options) is None

    def resident_bytes(self) -> int:
        """Return the resident memory of the process."""
        try:
            pages = Path(f"/proc/{self._process.pid}/statm").read_text(encoding="ascii").split()[1]
        except (OSError, IndexError):  # the process has ended
            return 0
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def end(self) -> str:
        """Kill the process and its group; return a clause that says how it ended."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        code = self._process.wait()
        self.connection.close()
        os.close(self._lifeline)
        return f"exited with code {code}" if code >= 0 else f"was killed by {_name(-code)}"


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


class LocalPool(Pool):
    """Processes of this machine, started on demand; see ``twinct.workers.Pool``.

    Work starts in the order of submission; while the first in line waits for memory, at most 16
    others that fit may overtake it. Idle workers stay warm unless running work may need their
    memory. The kernel kills the workers when this process ends, however it ends. Work uses offers
    at their own paths, without a copy.
    """

    def __init__(
        self, folder: Path, *, workers: int, threads: int = 1, memory_bytes: int | None = None
    ) -> None:
        """Create the pool without starting any process.

        Args:
            folder: folder for files of the work; the workers' output goes to its ``logs``.
            workers: largest number of processes.
            threads: threads of each process.
            memory_bytes: memory limit of all processes; None: the memory available now.

        Raises:
            InputError: fewer than one worker, thread or byte.
        """
        most = available_bytes()[0] if memory_bytes is None else memory_bytes
        data = {"workers": workers, "threads": threads, "memory_bytes": most}
        if problems := [f"{k}={v}: must be at least 1" for k, v in data.items() if v < 1]:
            raise InputError(problems)
        super().__init__()
        self.folder = Path(folder).absolute()
        self._slots, self._threads, self._memory = workers, threads, int(min(most, 2**62))
        self._queue: deque[Work] = deque()
        self._passed = 0
        self._workers: list[_Worker] = []

    @property
    def slots(self) -> int:
        """Largest number of processes."""
        return self._slots

    @property
    def most_memory_bytes(self) -> int:
        """Memory limit of the whole pool."""
        return self._memory

    def save(self, done: Done, name: str, path: Path) -> None:
        """Hard-link a file or folder that work attached to a path, or copy it to another disk."""
        save_linked(done.artifacts[name], path)

    def _start(self, work: Work, request: bytes) -> None:
        inputs = {name: self._offers[name] for name in work.inputs}
        self._queue.append(replace(work, argument=pickle.dumps((request, inputs))))
        self._start_what_fits()

    def _events(self, timeout_s: float | None) -> list[Event]:
        until = None if timeout_s is None else time.monotonic() + timeout_s
        events: list[Event] = []
        self._start_what_fits()
        while not events:
            left = None if until is None else max(until - time.monotonic(), 0.0)
            ready = wait([worker.connection for worker in self._workers], left)
            for worker in [w for w in self._workers if w.connection in ready]:
                events += self._hear(worker)
            self._start_what_fits()
            if not ready:
                break
        return events

    @postponed()
    def close(self, *, clear: bool = False) -> None:
        """End all processes; running work is not reported any more."""
        self.closed = True
        self._queue.clear()
        self._keys.clear()
        while self._workers:
            self._remove(self._workers[-1])
        if clear:
            remove_folder(self.folder)

    def _start_what_fits(self) -> None:
        while (place := self._next()) is not None:
            task = self._queue[place]
            worker = self._free_worker()
            worker.task = task
            self._make_room()
            with contextlib.suppress(OSError):  # the worker has just died; ``wait`` reports it
                worker.connection.send_bytes(task.argument)
            del self._queue[place]
            self._passed = 0 if place == 0 else self._passed + 1

    def _next(self) -> int | None:
        """Return the place in the queue of the next task that may start; None if there is none."""
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
        """Return an idle worker, or else start one."""
        for worker in [w for w in self._workers if w.task is None]:
            if worker.alive:
                return worker
            self._remove(worker)
        number = min(set(range(self._slots)) - {worker.number for worker in self._workers})
        self._workers.append(_Worker(number, self.folder, self._threads))
        return self._workers[-1]

    def _make_room(self) -> None:
        """End idle workers whose memory the running workers may need."""
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
            event: Done | Failed = pickle.loads(worker.connection.recv_bytes())
        except (EOFError, OSError):
            how = self._remove(worker)
            return [] if task is None else [Died(task.key, f"its worker {how}")]
        assert task is not None
        worker.task = None
        return [received(event)]
