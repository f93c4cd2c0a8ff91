"""What workers of one node share: made once, whoever asks and whoever dies."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from planted import planted, unpickled
from waiting import HANG_S, until

from twinct.core.errors import InputError
from twinct.core.files.private import DRAFT
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


def test_arrays_are_made_once_and_come_back_the_same(tmp_path: Path) -> None:
    cache, calls = Cache(tmp_path), []

    def make() -> np.ndarray:
        calls.append(1)
        return np.arange(6.0).reshape(2, 3)

    for _ in range(2):
        np.testing.assert_array_equal(cache.array("a", make), np.arange(6.0).reshape(2, 3))
    assert len(calls) == 1
    cache.array("other", make)
    assert len(calls) == 2


@pytest.mark.parametrize("junk", [b"", b"no array", planted(Path("never"))])
def test_what_is_damaged_is_made_again_and_said(tmp_path: Path, junk: bytes, caplog) -> None:
    cache = Cache(tmp_path)
    cache.array("a", lambda: np.zeros(2))
    (kept,) = [path for path in (tmp_path / "arrays").iterdir() if path.name == "a"]
    kept.write_bytes(junk)
    for _ in range(2):
        assert cache.array("a", lambda: np.ones(2)).tolist() == [1, 1]
    assert caplog.text.count("it is made again") == 1 and str(kept) in caplog.text


def test_a_link_in_place_of_a_draft_leads_to_no_other_file(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_text("mine")
    (tmp_path / "arrays").mkdir()
    (tmp_path / "arrays" / ".a.partial").symlink_to(other)
    assert Cache(tmp_path).array("a", lambda: np.zeros(1)).tolist() == [0]
    (tmp_path / "scans").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "scans" / ".b.partial").symlink_to(tmp_path / "elsewhere")
    made = Cache(tmp_path).path("scans", "b", lambda draft: (draft.mkdir(), (draft / "1").touch()))
    assert (made / "1").is_file() and not list((tmp_path / "elsewhere").iterdir())
    (tmp_path / "scans" / ".c.partial").mkdir()
    (tmp_path / "scans" / ".c.partial" / "1").symlink_to(other)
    with pytest.raises(InputError, match=r"\.c\.partial/1 is a symbolic link"):
        Cache(tmp_path).path("scans", "c", lambda draft: (draft / "1").touch())
    (tmp_path / "scans" / ".d.lock").symlink_to(tmp_path / "made")
    with pytest.raises(InputError, match=r"\.d\.lock is a symbolic link"):
        Cache(tmp_path).path("scans", "d", Path.mkdir)
    assert other.read_text() == "mine" and not (tmp_path / "made").exists()


def test_pickles_of_earlier_versions_go_unread(tmp_path: Path) -> None:
    (tmp_path / "things").mkdir()
    (tmp_path / "things" / "digest-0.1.0").write_bytes(planted(tmp_path / "mark"))
    with unpickled() as found:
        assert Cache(tmp_path).remove_pickles()
        assert not Cache(tmp_path).remove_pickles()
    assert not found and not list(tmp_path.iterdir())


def test_what_could_not_be_made_is_not_there_and_may_be_asked_for_again(tmp_path: Path) -> None:
    cache = Cache(tmp_path)

    def fail() -> np.ndarray:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        cache.array("a", fail)
    assert cache.array("a", lambda: np.zeros(1)).tolist() == [0]


def test_what_a_dead_worker_left_goes_with_the_locks(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    cache.array("a", lambda: np.zeros(1))
    passing = tmp_path / f"{DRAFT}abcdefgh"
    Cache(passing).array("a", lambda: np.zeros(1))
    (passing / ".held").touch()
    begun = tmp_path / "scans" / ".b.partial" / "scan.zarr" / "status"
    for draft in (begun, tmp_path / "scans" / ".a.partial" / "scan.zarr.new"):
        draft.mkdir(parents=True)
    (begun / "c.0").touch()
    cache.remove_locks()
    assert cache.array("a", lambda: np.ones(1)).tolist() == [0]
    assert {path.name for path in tmp_path.iterdir()} == {"arrays", "scans"}
    assert [path.name for path in tmp_path.glob("*/.*.partial")] == [".b.partial"]
