"""Command line: ``twinct check | run | report | export | ...``; all of them are in ``commands``."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from types import FrameType

from twinct.core.errors import TwinctError
from twinct.core.foreign_text import shortened
from twinct.core.threads import limit_threads
from twinct.version import __version__

EXIT_DONE, EXIT_OTHER, EXIT_BAD_INPUT = 0, 1, 2


def main(argv: Sequence[str] | None = None) -> None:
    """Run one command and end the process: 0 done, 2 bad input, 1 anything else."""
    sys.exit(run_command(argv))


def run_command(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; errors go to stderr, without a traceback."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    if arguments == ["--version"]:
        sys.stdout.write(f"twinct {__version__}\n")
        return EXIT_DONE
    signal.signal(signal.SIGTERM, _as_interrupt)
    try:
        limit_threads()  # before the libraries that it limits are loaded
        from twinct.cli.commands import app
        from twinct.cli.old_spelling import respelled

        app.cli(
            prog="twinct",
            description="Simulates a twin robotic CT system from one scenario file: two arms, "
            "X-ray projections, ROS 2, reconstruction and evaluation. "
            "--version prints the version.",
            args=respelled(arguments),
        )
    except SystemExit as stop:  # tyro: 0 after --help, 2 after invalid arguments
        return stop.code if isinstance(stop.code, int) else EXIT_OTHER
    except TwinctError as error:
        for line in error.lines:
            _say(f"twinct: {line}")
        return error.exit_code
    except KeyboardInterrupt:
        kept = _KEPT.get(next(iter(arguments), ""))
        _say(
            "twinct: interrupted"
            f"{f'; every {kept} is kept, continue with --resume' if kept else ''}"
        )
        return EXIT_OTHER
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OTHER
    except Exception as error:
        if os.environ.get("TWINCT_DEBUG"):
            traceback.print_exc()
        _say(
            f"twinct: unexpected {type(error).__name__}: {shortened(str(error))}\n"
            "twinct: this is a bug in twinct; set TWINCT_DEBUG=1 to see where"
        )
        return EXIT_OTHER
    return EXIT_DONE


_KEPT = {"run": "acquired view", "study": "finished trial"}
"""Results that an interrupted command keeps, if it can be resumed."""


def _say(message: str) -> None:
    sys.stderr.write(message + "\n")
    sys.stderr.flush()


def _as_interrupt(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
