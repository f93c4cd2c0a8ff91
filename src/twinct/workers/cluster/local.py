"""Start and end of Ray on this machine: on loopback, with a token, without leftovers."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import secrets
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from twinct.core.errors import InputError, LinkError
from twinct.core.files.private import private_folder

_LOOPBACK = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""If it is 0, Ray accepts 127.0.0.1, and listens there only, instead of the machine's address."""

ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_BACKEND_LOG_LEVEL": "fatal",  # errors arrive as exceptions anyway
    "RAY_IGNORE_UNHANDLED_ERRORS": "1",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # otherwise Ray prints advice
    "RAY_DEDUP_LOGS_SKIP_REGEX": "^",  # events report deaths; suppress Ray's own messages
    _LOOPBACK: "0",
}
"""Environment variables of every process that uses Ray, which reads them at its import."""

CLIENT = {"RAY_NUM_REDIS_GET_RETRIES": "2", "RAY_py_gcs_connect_timeout_s": "5"}
"""Further variables of a process that joins a running Ray: timeouts of a few seconds."""

PATIENCE_S = 300.0
"""Timeout of the start: a busy machine starts Ray in half a minute, a very busy one in minutes."""

_GAVE_UP = "timed out during startup"
"""Words of Ray when its own node does not come within the 30 s that it waits."""

_PREFIX, _LIFELINE = "twinct-ray-", "lifeline"


def set_environment(*, local: bool) -> None:
    """Set the variables that Ray reads at its import, for the rest of this process.

    Args:
        local: require a token; create one, unless the environment has one.

    Raises:
        InputError: Ray was imported before, without what a local Ray needs.
    """
    needed = ENVIRONMENT | ({"RAY_AUTH_MODE": "token"} if local else {})
    imported = "ray" in sys.modules
    settled = ("RAY_AUTH_MODE", _LOOPBACK) if local and imported else ()
    if others := [name for name in settled if os.environ.get(name) != needed[name]]:
        raise InputError(
            f"local: Ray was imported before {' and '.join(others)} could be set, and reads its "
            "settings only then; create this pool first, or in another process"
        )
    os.environ |= needed | CLIENT
    if local and not imported and "RAY_AUTH_TOKEN_PATH" not in os.environ:
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))


class GaveUpError(LinkError):
    """Ray did not wait long enough for its own processes, as on a very busy machine."""


def start(processors: int, memory_bytes: int) -> LocalRay:
    """Start Ray, and start it again if it gives up too early.

    Args:
        processors: processors that Ray offers.
        memory_bytes: memory that Ray offers.

    Raises:
        LinkError: Ray did not start.
    """
    latest = time.monotonic() + PATIENCE_S
    while True:
        try:
            return LocalRay(processors, memory_bytes)
        except GaveUpError:
            if time.monotonic() > latest:
                raise


class LocalRay:
    """Ray's processes on this machine.

    Attributes:
        address: address of Ray.
        lifeline: a named pipe that this process holds open while it lives.
    """

    def __init__(self, processors: int, memory_bytes: int) -> None:
        """Start Ray.

        Raises:
            GaveUpError: Ray did not wait long enough for its own processes.
            LinkError: Ray did not start.
        """
        self._teardown = contextlib.ExitStack()
        # Paths of sockets must be short, so TMPDIR is not used.
        self._folder = self._teardown.enter_context(private_folder(Path("/tmp"), _PREFIX))
        self.lifeline = self._folder / _LIFELINE
        unheld = self._folder / "unheld"
        os.mkfifo(unheld)
        self._held = os.open(unheld, os.O_RDWR | os.O_CLOEXEC)
        unheld.rename(self.lifeline)  # a pipe of this name always has a holder
        self.address = f"127.0.0.1:{_free_port()}"
        options = {
            "node-ip-address": "127.0.0.1",
            "port": self.address.rpartition(":")[2],
            "num-cpus": processors,
            "memory": memory_bytes,
            "temp-dir": self._folder,
            "include-dashboard": "false",
            "min-worker-port": 0,  # any: other pools have workers, too
            "max-worker-port": 0,
        }
        if importlib.util.find_spec("grpc") is not None:  # Ray starts a server that nobody needs
            options["ray-client-server-port"] = _free_port()
        log = self._folder / "head.log"
        with log.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "twinct.workers.cluster.head", str(self.lifeline)]
                + ["--head", *(f"--{name}={value}" for name, value in options.items())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                process_group=0,
                env={
                    **{k: v for k, v in os.environ.items() if k not in CLIENT},
                    "PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path),
                },
            )
        try:
            output = self._process.stdout
            assert output is not None
            ready = select.select([output], [], [], PATIENCE_S)[0]
            if not ready or not output.readline():
                last = log.read_text(errors="replace").strip().splitlines()[-1:]
                said = " ".join(last) or f"no answer within {PATIENCE_S:.0f} s"
                kind = GaveUpError if _GAVE_UP in said else LinkError
                raise kind(f"Ray did not start: {said}")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Kill all processes of Ray and their descendants."""
        family = list(_descendants(self._process.pid))
        os.close(self._held)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        for pid in family:  # idle workers have groups of their own
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._process.communicate()
        self._teardown.close()


def _free_port() -> int:
    """Return a free port outside the range that the kernel gives to others meanwhile."""
    while True:
        port = secrets.choice(range(20_000, 32_000))
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def _descendants(pid: int) -> Iterator[int]:
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in map(int, path.read_text().split()):
                yield child
                yield from _descendants(child)
