"""Ended by the kernel with somebody else."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal


def end_with(lifeline: int) -> None:
    """Let the kernel kill this process and its group when the other end of a pipe is closed.

    It does so however its holder ends, and whatever this process is doing: a thread that watches
    would wait for an engine that holds the interpreter. (Linux, fcntl(2): O_ASYNC, F_SETSIG.)

    Args:
        lifeline: descriptor of the reading end, this process's own; nothing is ever written.
    """
    os.set_inheritable(lifeline, False)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, -os.getpgrp())
    fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(lifeline, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):  # it is held
        os.read(lifeline, 1)
        os.killpg(0, signal.SIGKILL)  # it was closed before
