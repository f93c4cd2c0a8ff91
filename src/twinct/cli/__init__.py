"""Command line: ``twinct check | run | report | export | ...``; all of them are in ``commands``."""

from __future__ import annotations

import atexit
import logging
import os
import select
import shutil
import signal
import sys
import traceback
from collections.abc import Sequence

from twinct.core.errors import TwinctError
from twinct.core.foreign_text import shortened
from twinct.core.interruption import (
    EndedBySignal,
    end_like_ctrl_c,
    end_no_more,
    hear_lost_signals,
    ignore_endings,
    notes_of,
    swallowed,
)
from twinct.core.memory import available_bytes, lacks_memory, load_blas_if_limited
from twinct.core.threads import limit_threads
from twinct.link.environment import take_ros_arguments
from twinct.version import __version__

EXIT_DONE, EXIT_OTHER, EXIT_BAD_INPUT = 0, 1, 2
EXIT_SIGNAL = 128
"""Added to the number of a signal, as shells do: 130 for Ctrl-C, 143 for SIGTERM."""

WIDEST = 100
"""Columns of the help of twinct itself, at most."""

ZARR_S = 60.0
"""Longest wait for Zarr's event loop, which stops at once unless the machine is very busy."""


def main(argv: Sequence[str] | None = None) -> None:
    """Run one command and end the process; see ``run_command`` for the exit code."""
    if argv is None:
        _settle_on_utf8()
    atexit.register(ignore_endings)  # registered first, called last
    hear_lost_signals()
    try:
        code = run_command(argv)
        end_no_more()
    except KeyboardInterrupt as stop:  # after the last line of the command
        end_no_more()
        code = _code_of_interruption(stop)
    if code > EXIT_SIGNAL:
        logging.getLogger("asyncio").disabled = True  # readings of Zarr that were cut short
        for number in (signal.SIGINT, signal.SIGTERM):  # another one ends the process at once
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
    atexit.register(_stop_zarr)  # registered after Zarr's own, called before it
    sys.exit(code)


def _stop_zarr() -> None:
    """Stop Zarr's event loop: at the exit Zarr waits 0.2 s for its end, then shows a traceback."""
    sync = sys.modules.get("zarr.core.sync")
    loop, thread = (sync.loop[0], sync.iothread[0]) if sync is not None else (None, None)
    if loop is not None and thread is not None:
        loop.call_soon_threadsafe(loop.stop)
        thread.join(ZARR_S)


def _settle_on_utf8() -> None:
    """Start again in Python's UTF-8 mode, if it reads the names of files as ASCII (LANG=C).

    It then has names that neither JSON nor any library takes.
    """
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def run_command(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; errors go to stderr, without a traceback.

    Returns:
        0: done. 2: bad input. 128 + the number of a signal: ended by Ctrl-C (130), SIGTERM (143),
        SIGHUP (129), or because nobody reads the output any more (141). 1: anything else.
    """
    end_like_ctrl_c(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    _open_closed_streams()
    try:
        code = _code_of(sys.argv[1:] if argv is None else list(argv))
        sys.stdout.flush()
    except KeyboardInterrupt as stop:  # also while a message is written
        code = _code_of_interruption(stop)
    except BrokenPipeError:
        _close_unread()
        code = EXIT_SIGNAL + signal.SIGPIPE
    except (MemoryError, SystemError) as error:  # Python found no memory for the exception itself
        code = _say_memory(error)
    return code


def _code_of_interruption(stop: KeyboardInterrupt) -> int:
    """Say what an interrupted command keeps."""
    number = stop.number if isinstance(stop, EndedBySignal) else signal.SIGINT
    notes = "; ".join(notes_of(stop)) or "before anything new was complete; earlier results stay"
    try:
        _say(f"twinct: interrupted: {notes}")
    except BrokenPipeError:
        _close_unread()
    return EXIT_SIGNAL + number


def _code_of(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        sys.stdout.write(f"twinct {__version__}\n")
        return EXIT_DONE
    try:
        limit_threads()  # before the libraries that it limits are loaded
        load_blas_if_limited()
        if arguments[:1] in (["node"], ["drive"]):
            arguments = take_ros_arguments(arguments)
        from twinct.cli import commands

        if arguments in ([], ["-h"], ["--help"]):
            width = min(shutil.get_terminal_size().columns, WIDEST)
            sys.stdout.write(commands.overview(width))
        elif arguments[:1] == ["--completion"]:
            shell = ["--tyro-print-completion", *arguments[1:]]
            commands.application().cli(prog="twinct", args=shell)
        else:
            commands.check_names(arguments)
            commands.execute(arguments)
    except SystemExit as stop:  # tyro: 0 after --help, 2 after invalid arguments
        if isinstance(stop.__context__, BrokenPipeError):  # rich
            raise stop.__context__ from None
        code = stop.code or EXIT_DONE  # None after completion is printed
        return code if isinstance(code, int) else EXIT_OTHER
    except TwinctError as error:
        return _code_of_own(error)
    except Exception as error:
        return _code_of_foreign(error)
    return EXIT_DONE


def _code_of_own(error: TwinctError) -> int:
    """Say an error, unless an interruption led to it or waits for the end of an import."""
    if stop := swallowed():
        raise stop from error
    for line in error.lines:
        _say(f"twinct: {line}")
    return error.exit_code


def _code_of_foreign(error: Exception) -> int:
    """Say what a foreign exception means, unless it is the trace of an interruption."""
    if isinstance(error, BrokenPipeError) and _unread():
        raise error
    if stop := swallowed():
        raise stop from error
    if os.environ.get("TWINCT_DEBUG"):
        traceback.print_exc()
    if lacks_memory(error):
        return _say_memory(error)
    _say(
        f"twinct: unexpected {type(error).__name__}: {shortened(str(error))}\n"
        "twinct: this is a bug in twinct; set TWINCT_DEBUG=1 to see where"
    )
    return EXIT_OTHER


def _say_memory(error: Exception) -> int:
    try:
        _say(
            f"twinct: too little memory, by the {available_bytes()[1]}: "
            f"{type(error).__name__}: {shortened(str(error))}"
        )
    except (MemoryError, SystemError):
        os.write(2, b"twinct: too little memory\n")
    return EXIT_BAD_INPUT


def _say(message: str) -> None:
    sys.stderr.write(message + "\n")
    sys.stderr.flush()


def _open_closed_streams() -> None:
    """Discard what is written to streams that were closed, as by ``>&-``.

    Otherwise files that are opened get their numbers, and output of libraries goes there.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - until the end


def _unread() -> list[int]:
    """Return the descriptors among stdout and stderr that are pipes without a reader."""
    watched = select.poll()
    for stream in (1, 2):
        watched.register(stream, 0)
    return [stream for stream, events in watched.poll(0) if events & select.POLLERR]


def _close_unread() -> None:
    """Discard output that nobody reads, so that the end of the process does not fail with it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in _unread():
        os.dup2(nowhere, stream)
    os.close(nowhere)
