"""Node processes of a scan: start, supervision and end, with none left behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from twinct.core.files.links import no_link
from twinct.link import heartbeat
from twinct.link.environment import SHARED_MEMORY, free_shared_memory
from twinct.link.heartbeat import LOOK_S, Pulse

TERM_S, KILL_S = 3.0, 10.0
"""A node ends by itself in 1.5 s; if a long call blocks it, such as gVXR's import, by force."""
TAIL_BYTES, TAIL_LINES = 8192, 15


def _why(number: int) -> str:
    """Return what a signal says about a node of ROS 2, as far as it says anything."""
    if number != signal.SIGBUS:
        return ""
    free = free_shared_memory()
    return (
        f", because {SHARED_MEMORY} had no room: it has {free or 0} free bytes now. Remove files "
        "there that no process uses; a container gets more with --shm-size=64m"
    )


class NodeProcess:
    """A child process in a separate session, which ends when its stdin ends.

    Ctrl-C in the terminal reaches only the parent, which then stops its nodes. The parent holds the
    other end of their stdin, a socket. So nodes notice any death of the parent, and each side
    notices when the other hangs.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        *,
        environment: Mapping[str, str],
        inherit: Sequence[int] = (),
        beats: bool = False,
        on_end: Callable[[NodeProcess], None],
    ) -> None:
        """Start the process.

        Args:
            name: name for messages.
            command: program and arguments.
            log: file to append its output to.
            environment: its environment.
            inherit: file descriptors that it inherits.
            beats: expect beats, and kill the process when they stop; see ``Pulse``.
            on_end: called with this object, from a thread, after any end of the process.
        """
        self.name, self.log = name, log
        own, its = socket.socketpair()
        with open(log, "ab", opener=no_link) as output, its:
            self._start_of_log = output.tell()
            self._process = subprocess.Popen(
                command,
                stdin=its.fileno(),
                stdout=output,
                stderr=subprocess.STDOUT,
                env=dict(environment),
                pass_fds=tuple(inherit),
                start_new_session=True,
            )
        self._on_end = on_end
        self._ended = threading.Event()
        self._silent = False
        self._pulse = Pulse(own, self.pid)
        self._threads = [
            threading.Thread(target=watch, name=f"{watch.__name__} {name}", daemon=True)
            for watch in (self._wait, *([self._listen] if beats else []))
        ]
        for thread in self._threads:
            thread.start()

    def _wait(self) -> None:
        self._process.wait()
        self._ended.set()
        self._on_end(self)

    def _listen(self) -> None:
        while not self._ended.wait(LOOK_S):
            if not self._pulse.look():
                self._silent = True
                self._kill()
                return

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while the process runs; minus the signal's number if one ended it."""
        return self._process.returncode if self._ended.is_set() else None

    def describe_end(self) -> str:
        """Return text on the end of the process, with the last lines that it printed."""
        code = self.exit_code
        how = f"ended with exit code {code}"
        if self._silent:
            how = (
                "hung or was stopped: it was silent and idle for "
                f"{heartbeat.SILENCE_S:.0f} s, so it was killed"
            )
        elif code is not None and code < 0:
            with suppress(ValueError):
                how = f"was ended by {signal.Signals(-code).name}"
            how += _why(-code)
        with self.log.open("rb") as log:
            size = log.seek(0, os.SEEK_END)
            log.seek(max(self._start_of_log, size - TAIL_BYTES))
            lines = log.read().decode(errors="replace").strip().splitlines()[-TAIL_LINES:]
        tail = ":\n  " + "\n  ".join(lines) if lines else ", and printed nothing"
        return f"the {self.name} node {how}{tail}"

    def request_stop(self) -> None:
        """Ask the process to end."""
        self._pulse.close()
        if not self._ended.is_set():
            with suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGTERM)

    def stop(self) -> None:
        """End the process, by force if necessary, and wait for its end."""
        self.request_stop()
        if not self._ended.wait(TERM_S):
            self._kill()
            self._ended.wait(KILL_S)
        for thread in self._threads:
            thread.join(KILL_S)

    def _kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
