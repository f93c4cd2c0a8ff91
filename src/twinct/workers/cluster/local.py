"""Start and end of Ray on this machine: on loopback, with a token, without leftovers."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from twinct.core.errors import LinkError

ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_BACKEND_LOG_LEVEL": "fatal",  # errors arrive as exceptions anyway
    "RAY_IGNORE_UNHANDLED_ERRORS": "1",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # otherwise Ray prints advice
}
"""Environment variables of every process that uses Ray."""

CLIENT = {"RAY_NUM_REDIS_GET_RETRIES": "2", "RAY_py_gcs_connect_timeout_s": "5"}
"""Further variables of a process that joins a running Ray: timeouts of a few seconds."""

PATIENCE_S = 300.0
"""Timeout of the start: a busy machine starts Ray in half a minute, a very busy one in minutes."""


_PREFIX, _LIFELINE = "twinct-ray-", "lifeline"


class LocalRay:
    """Ray's processes on this machine.

    Attributes:
        address: address of Ray.
        lifeline: a named pipe that this process holds open while it lives.
    """

    def __init__(self, processors: int, memory_bytes: int) -> None:
        """Start Ray.

        Raises:
            LinkError: Ray did not start.
        """
        # Paths of sockets must be short, so TMPDIR is not used.
        _sweep()
        self._folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir="/tmp"))
        self.lifeline = self._folder / _LIFELINE
        unheld = self._folder / "unheld"
        os.mkfifo(unheld)
        self._held = os.open(unheld, os.O_RDWR | os.O_CLOEXEC)
        unheld.rename(self.lifeline)  # a pipe of this name always has a holder
        read, self._group = os.pipe()
        heard, report = os.pipe()
        self._before = {name: os.environ.get(name) for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN")}
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
        settings = {"num_cpus": processors, "_memory": memory_bytes, "_temp_dir": str(self._folder)}
        self._log = self._folder / "head.log"
        with self._log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "twinct.workers.cluster.head"]
                + [str(read), str(report), json.dumps(settings)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=(read, report),
                process_group=0,
                env={
                    **{k: v for k, v in os.environ.items() if k not in CLIENT},
                    **ENVIRONMENT,
                    # Ray then uses and listens on loopback only.
                    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
                    "PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path),
                },
            )
        os.close(read)
        os.close(report)
        try:
            ready = select.select([heard], [], [], PATIENCE_S)[0]
            self.address = os.read(heard, 256).decode() if ready else ""
            if not self.address:
                last = self._log.read_text(errors="replace").strip().splitlines()[-1:]
                raise LinkError(
                    f"Ray did not start: {' '.join(last) or f'no answer within {PATIENCE_S:.0f} s'}"
                )
        except BaseException:
            self.close()
            raise
        finally:
            os.close(heard)

    @property
    def alive(self) -> bool:
        """True while the process that started Ray lives."""
        return self._process.poll() is None

    def close(self) -> None:
        """Kill all processes of Ray and their descendants."""
        family = list(_descendants(self._process.pid))
        os.close(self._held)
        os.close(self._group)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        for pid in family:  # idle workers have groups of their own
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._process.wait()
        for name, value in self._before.items():
            os.environ.pop(name, None)
            os.environ |= {name: value} if value is not None else {}
        shutil.rmtree(self._folder, ignore_errors=True)


def _sweep() -> None:
    """Remove folders of killed processes, whose lifelines have no holder."""
    for folder in Path("/tmp").glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # not ours, or held (BlockingIOError)
            pipe = os.open(folder / _LIFELINE, os.O_RDONLY | os.O_NONBLOCK)
            try:
                os.read(pipe, 1)
            finally:
                os.close(pipe)
            shutil.rmtree(folder, ignore_errors=True)


def _descendants(pid: int) -> Iterator[int]:
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, path.read_text().split()):
                yield child
                yield from _descendants(child)
