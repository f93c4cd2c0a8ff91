"""Short work ends before a signal that ends work: no draft and no lock stays behind."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from waiting import until

from twinct.core.files.lock import sole_owner
from twinct.core.files.private import private_folder
from twinct.core.interruption import (
    ENDING,
    EndedBySignal,
    end_like_ctrl_c,
    hear_lost_signals,
    postponed,
)


@pytest.fixture(autouse=True)
def _ended_by_signals() -> Any:
    before = {number: signal.getsignal(number) for number in ENDING}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    end_like_ctrl_c(signal.SIGTERM)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def interrupting(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that is interrupted when it has done its work."""

    def call(*args: Any, **more: Any) -> Any:
        done = function(*args, **more)
        signal.raise_signal(signal.SIGINT)
        return done

    return call


def test_a_signal_waits_for_the_end_of_the_block() -> None:
    done: list[int] = []
    with pytest.raises(EndedBySignal) as ended, postponed():
        signal.raise_signal(signal.SIGTERM)
        with postponed():
            signal.raise_signal(signal.SIGTERM)
            done.append(1)
        done.append(2)
    assert done == [1, 2]
    assert ended.value.number == signal.SIGTERM
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_of_the_block_is_kept_beside_the_signal() -> None:
    with pytest.raises(KeyboardInterrupt) as ended, postponed():
        signal.raise_signal(signal.SIGINT)
        raise OSError("disk")
    assert isinstance(ended.value.__context__, OSError)


def test_other_threads_change_no_handler() -> None:
    found: list[object] = []

    def work() -> None:
        with postponed():
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [signal.default_int_handler]


def test_a_lock_goes_though_its_owner_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the moments at which the file appears, and at which it goes."""
    lock = tmp_path / ".lock"
    for name in ("open", "unlink"):
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(os, name, interrupting(getattr(os, name)))
            with sole_owner(lock):
                pass
        assert not lock.exists(), name


def test_a_second_interruption_does_not_stop_the_clean_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(KeyboardInterrupt), private_folder(tmp_path) as folder:
        for i in range(3):
            (folder / str(i)).touch()
        monkeypatch.setattr(os, "unlink", interrupting(os.unlink))
        signal.raise_signal(signal.SIGINT)
    assert not list(tmp_path.iterdir())


SWALLOWING = """
try:
    import {inner}
except BaseException as error:  # as trimesh does
    kept = error
whole = True
"""
SIGNALLED = """
import signal
for _ in range({times}):
    signal.raise_signal(signal.SIGTERM)
"""


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that makes a module that imports another one, and returns its name."""
    monkeypatch.syspath_prepend(tmp_path)

    def make(name: str, times: int) -> str:
        (tmp_path / f"{name}_inner.py").write_text(SIGNALLED.format(times=times))
        (tmp_path / f"{name}.py").write_text(SWALLOWING.format(inner=f"{name}_inner"))
        return name

    return make


def test_a_signal_waits_for_the_end_of_an_import(modules: Any) -> None:
    name = modules("signalled_once", 1)
    with pytest.raises(EndedBySignal) as ended:
        import_module(name)
        until(lambda: False, "the signal")
    assert ended.value.number == signal.SIGTERM
    assert sys.modules[name].whole and not hasattr(sys.modules[name], "kept")


def test_a_second_signal_ends_the_import(modules: Any) -> None:
    name = modules("signalled_twice", 2)
    with pytest.raises(EndedBySignal):
        import_module(name)
        assert isinstance(sys.modules[name].kept, EndedBySignal)  # raised at once
        until(lambda: False, "the signal, which the module swallowed")


def test_a_signal_that_python_only_prints_comes_again(monkeypatch: pytest.MonkeyPatch) -> None:
    class Dying:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)

    others: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", others.append)
    hear_lost_signals()
    with pytest.raises(EndedBySignal):
        Dying()
        until(lambda: False, "the signal")
    assert not others
    monkeypatch.setattr(Dying, "__del__", lambda _: 1 / 0)
    Dying()
    assert [type(one.exc_value) for one in others] == [ZeroDivisionError]
