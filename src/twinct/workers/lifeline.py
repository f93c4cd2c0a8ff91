"""A process that the kernel ends together with its parent."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal


def end_with(lifeline: int) -> None:
    """Let the kernel kill this process and its group when the other end of a pipe is closed.

    This works however the holder of the pipe ends, and whatever this process is doing: a watching
    thread would have to wait for an engine that holds the interpreter. (Linux, fcntl(2): O_ASYNC,
    F_SETSIG.)

    Args:
        lifeline: descriptor of the reading end, owned by this process; nothing is ever written.
    """
    os.set_inheritable(lifeline, False)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, -os.getpgrp())
    fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(lifeline, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):  # the other end is open
        os.read(lifeline, 1)
        os.killpg(0, signal.SIGKILL)  # it was closed before this call
