"""What workers of one node share: made once, whoever asks and whoever dies."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S, until

from twinct.study.cache import Cache

# Forked: a process that imports all of twinct takes seconds.
PROCESSES = multiprocessing.get_context("fork")


def make(draft: Path, folder: Path, *, die: bool = False) -> None:
    """Say who begins, wait for the gate, a named pipe; goes on from what is there."""
    draft.mkdir(exist_ok=True)
    if (draft / "begun").exists():
        (draft / "went on").write_text("")
    (draft / "begun").write_text(str(os.getpid()))
    if die:
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / f"makes {os.getpid()}").touch()
    (folder / "gate").open().close()
    (draft / "made").write_text(str(os.getpid()))


def ask(folder: Path, die: bool) -> None:
    lock = fcntl.flock

    def told(descriptor: int, how: int) -> None:
        try:
            lock(descriptor, how | fcntl.LOCK_NB)
        except BlockingIOError:
            (folder / f"waits {os.getpid()}").touch()
            lock(descriptor, how)

    fcntl.flock = told  # of this process alone
    Cache(folder).path("things", "digest", lambda draft: make(draft, folder, die=die))


@pytest.mark.process
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_of_two_processes_one_makes_it_and_goes_on_from_a_dead_ones_draft(tmp_path: Path) -> None:
    killed = PROCESSES.Process(target=ask, args=(tmp_path, True))
    killed.start()
    killed.join(HANG_S)
    assert killed.exitcode == -signal.SIGKILL
    made = tmp_path / "things" / "digest" / "made"
    assert not made.parent.exists()
    os.mkfifo(tmp_path / "gate")
    both = [PROCESSES.Process(target=ask, args=(tmp_path, False)) for _ in range(2)]
    try:
        for process in both:
            process.start()
        until(lambda: len(list(tmp_path.glob("makes *")) + list(tmp_path.glob("waits *"))) == 2)
        (maker,) = tmp_path.glob("makes *")
        gate = os.open(tmp_path / "gate", os.O_RDWR)
        for process in both:
            process.join(HANG_S)
        os.close(gate)
        assert [process.exitcode for process in both] == [0, 0]
    finally:
        for process in both:
            process.kill()
    assert maker.name == f"makes {made.read_text()}"
    assert list(tmp_path.glob("makes *")) == [maker]
    assert (made.parent / "went on").exists()
    assert made.read_text() == (made.parent / "begun").read_text()  # by one of them alone


def test_things_are_made_once_and_come_back_the_same(tmp_path: Path) -> None:
    cache, calls = Cache(tmp_path), []

    def make() -> np.ndarray:
        calls.append(1)
        return np.arange(6.0).reshape(2, 3)

    for _ in range(2):
        np.testing.assert_array_equal(cache.array("a", make), np.arange(6.0).reshape(2, 3))
        assert cache.thing("b", lambda: calls.append(1) or {"x": (1, 2)}) == {"x": (1, 2)}
    assert len(calls) == 2
    cache.array("other", make)
    assert len(calls) == 3


def test_a_thing_of_another_version_is_made_again(tmp_path: Path, monkeypatch) -> None:
    cache = Cache(tmp_path)
    assert cache.thing("a", lambda: "old") == "old"
    monkeypatch.setattr("twinct.study.cache.__version__", "another")
    assert cache.thing("a", lambda: "new") == "new"


def test_what_could_not_be_made_is_not_there_and_may_be_asked_for_again(tmp_path: Path) -> None:
    cache = Cache(tmp_path)

    def fail() -> np.ndarray:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        cache.array("a", fail)
    assert cache.array("a", lambda: np.zeros(1)).tolist() == [0]
