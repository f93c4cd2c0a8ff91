"""How a command ends: by interrupts, without memory, with closed streams."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from threading import Thread
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from waiting import HANG_S

from twinct import cli
from twinct.cli import main, run_command
from twinct.core.interruption import keeping

NOTHING = "before anything new was complete; earlier results stay"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize(("kept", "said"), [("", NOTHING), ("DIR keeps it", "DIR keeps it")])
def test_an_interrupt_ends_with_its_signal_and_says_what_is_kept(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    number: signal.Signals,
    kept: str,
    said: str,
) -> None:
    def interrupted(*_: object) -> None:
        with keeping(lambda: kept):
            signal.raise_signal(number)

    monkeypatch.setattr("twinct.cli.commands.execute", interrupted)
    assert run_command(["run", "demo.yaml"]) == 128 + number
    assert capfd.readouterr().err == f"twinct: interrupted: {said}\n"


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_an_interrupt_that_a_library_swallows_is_no_bug(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], number: int, code: int
) -> None:
    """As trimesh does, which keeps what the import of another module raises, and fails later."""

    def imported(*_: object) -> None:
        try:
            signal.raise_signal(number)
        except BaseException as error:
            kept = error
        raise TypeError(f"unsupported operand: {kept!r}")

    monkeypatch.setattr("twinct.cli.commands.execute", imported)
    assert run_command(["check"]) == code
    said = "before anything new was complete; earlier results stay"
    assert capfd.readouterr().err == f"twinct: interrupted: {said}\n"
    monkeypatch.setattr("twinct.cli.commands.execute", lambda *_: 1 / 0)
    assert run_command(["check"]) == 1  # a bug of the next command stays one
    assert "unexpected ZeroDivisionError" in capfd.readouterr().err


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 3 GiB"),
        ImportError("_numbers.so: failed to map segment from shared object"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        RuntimeError("can't start new thread"),
        ValueError("mujoco: Could not allocate memory"),
        SystemError("error return without exception set"),
        SystemError("<built-in function x> returned NULL without setting an exception"),
    ],
)
def test_a_lack_of_memory_is_told_whatever_meets_it(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], error: Exception
) -> None:
    def lacking(*_: object) -> None:
        try:
            raise error
        except Exception as first:
            raise TypeError("something failed") from first

    for work in (lacking, Mock(side_effect=error)):
        monkeypatch.setattr("twinct.cli.commands.execute", work)
        assert run_command(["check"]) == 2
        assert re.match(r"twinct: too little memory, by the .*: \w+: ", capfd.readouterr().err)
    monkeypatch.setattr("twinct.cli._code_of", Mock(side_effect=SystemError("no exception set")))
    assert run_command(["check"]) == 2
    assert "too little memory" in capfd.readouterr().err
    monkeypatch.setattr("twinct.cli.available_bytes", Mock(side_effect=MemoryError))
    assert run_command(["check"]) == 2
    assert capfd.readouterr().err == "twinct: too little memory\n"


@pytest.mark.process
def test_a_command_with_little_memory_ends_at_once() -> None:
    """OpenBLAS, which SciPy brings, would try to allocate its buffers without end."""
    limit = partial(resource.setrlimit, resource.RLIMIT_AS, (300 * 2**20, 300 * 2**20))
    words = [sys.executable, "-m", "twinct", "check", "demo"]
    done = subprocess.run(words, preexec_fn=limit, capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 2
    assert re.match(r"twinct: too little memory: \d+ MiB are left by the limit", done.stderr)


def test_names_of_files_are_utf_8_whatever_the_locale(monkeypatch: pytest.MonkeyPatch) -> None:
    """With LANG=C and no coercion, no JSON could hold them."""
    begun = Mock()
    monkeypatch.setattr("twinct.cli.os.execv", begun)
    monkeypatch.setattr("twinct.cli.run_command", Mock(return_value=0))
    monkeypatch.setattr(sys, "getfilesystemencoding", lambda: "ascii")
    monkeypatch.setenv("PYTHONUTF8", "0")
    for _ in range(2):  # once, also where the command line of Python forbids it
        with pytest.raises(SystemExit):
            main()
    begun.assert_called_once_with(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    assert os.environ["PYTHONUTF8"] == "1"


def test_readings_that_an_interrupt_cuts_short_do_not_complain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Zarr's event loop would print their tracebacks."""
    logger = logging.getLogger("asyncio")
    monkeypatch.setattr(logger, "disabled", False)
    monkeypatch.setattr("twinct.cli.signal.signal", Mock())
    monkeypatch.setattr("twinct.cli.run_command", Mock(return_value=129))
    with pytest.raises(SystemExit):
        main(["check"])
    assert logger.disabled


def test_a_second_interrupt_cuts_the_end_short_but_not_what_is_said(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        with keeping(lambda: "outer"), ExitStack() as stack:
            stack.callback(signal.raise_signal, signal.SIGINT)
            with keeping(lambda: "inner"):
                signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("twinct.cli.commands.execute", interrupted)
    assert run_command(["run", "demo.yaml"]) == 128 + signal.SIGINT
    assert capfd.readouterr().err == "twinct: interrupted: outer; inner\n"


TELLING = """
import sys
import twinct.cli.commands
from rich.console import Console
from twinct.cli import main
from twinct.cli.progress import on_terminal, say
def work(*_):
    with on_terminal() as audience, audience.stage("work", 1) as step:
        audience.say("begun")
        step()
    {}
twinct.cli.commands.execute = work
main(["run"])
"""
"""A command that tells its progress and its result."""


@pytest.mark.process
@pytest.mark.parametrize("closed", ["stdout", "stderr", "both"])
@pytest.mark.parametrize("told", ["sys.stdout.write('x')", "say('x')", "Console().print('x')"])
def test_a_closed_pipe_ends_a_command_quietly(closed: str, told: str) -> None:
    """As SIGPIPE ends other programs, but after the work; lost progress harms nothing."""
    read, write = os.pipe()
    os.close(read)
    out, errors = (
        write if closed in (name, "both") else subprocess.PIPE for name in ("stdout", "stderr")
    )
    command = [sys.executable, "-c", TELLING.format(told)]
    with subprocess.Popen(command, text=True, stdout=out, stderr=errors) as ended:
        os.close(write)
        said = ended.communicate(timeout=HANG_S)
    assert ended.returncode == (0 if closed == "stderr" else 128 + signal.SIGPIPE)
    if closed == "stderr":
        assert said[0].split() == ["begun", "x"]
    elif closed == "stdout":
        assert said[1].startswith("work: 1 of 1") and len(said[1].splitlines()) == 1


@pytest.mark.process
def test_a_command_without_streams_does_its_work() -> None:
    words = [sys.executable, "-c", TELLING.format("print('x', flush=True)")]
    shell = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh"]
    assert subprocess.run([*shell, *words], timeout=HANG_S).returncode == 0


IGNORING = """
import signal
for number in (signal.SIGINT, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
import twinct.cli.commands
from twinct.cli import main
def work(*_):
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.raise_signal(number)
twinct.cli.commands.execute = work
main(["run"])
"""
"""A command that Ctrl-C and the end of its terminal meet, as a job in the background."""


@pytest.mark.process
def test_a_job_in_the_background_does_not_hear_ctrl_c() -> None:
    command = [sys.executable, "-c", IGNORING]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S)
    assert (done.returncode, done.stderr) == (0, "")


LATE = """
import atexit, signal, sys
import twinct.cli.commands
from twinct import cli
class Late:
    def __init__(self, number):
        self.number, self.send = number, signal.raise_signal
    def __del__(self):
        self.send(self.number)
kept = Late({number}) if "{moment}" == "end of Python" else None
if "{moment}" == "last handler":
    atexit.register(signal.raise_signal, {number})
if "{moment}" == "sys.exit":
    before = sys.exit
    def leave(code):
        signal.raise_signal({number})
        before(code)
    sys.exit = leave
if "{moment}" == "after the last line":
    run = cli.run_command
    def run_command(argv):
        run(argv)
        signal.raise_signal({number})
    cli.run_command = run_command
twinct.cli.commands.execute = lambda *_: None
cli.main(["run"])
"""
"""A command that a signal meets when its work is done."""


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("moment", "interrupted"),
    [
        ("after the last line", True),
        ("sys.exit", False),
        ("last handler", False),
        ("end of Python", False),
    ],
)
def test_a_signal_after_the_work_does_not_end_the_process_by_itself(
    moment: str, interrupted: bool, number: signal.Signals
) -> None:
    command = [sys.executable, "-c", LATE.format(moment=moment, number=int(number))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == (128 + number if interrupted else 0)
    assert done.stderr == (f"twinct: interrupted: {NOTHING}\n" if interrupted else "")


def test_the_event_loop_of_zarr_has_ended_before_the_process_exits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = asyncio.new_event_loop()
    thread = Thread(target=loop.run_forever, daemon=True)
    thread.start()
    zarrs = SimpleNamespace(loop=[loop], iothread=[thread])
    monkeypatch.setitem(sys.modules, "zarr.core.sync", zarrs)
    monkeypatch.setattr(cli, "run_command", lambda argv: 0)
    monkeypatch.setattr(cli, "hear_lost_signals", lambda: None)
    monkeypatch.setattr(cli, "end_no_more", lambda: None)
    registered: list[Callable[[], None]] = []
    monkeypatch.setattr(cli.atexit, "register", registered.append)
    with pytest.raises(SystemExit):
        cli.main([])
    assert thread.is_alive()  # a program that called main may go on
    registered[-1]()
    assert not thread.is_alive()
    loop.close()
