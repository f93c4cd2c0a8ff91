"""A folder has one owner, and a dead one's lock is free."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from waiting import HANG_S

from twinct.core.errors import FolderInUseError, StorageError
from twinct.core.files.lock import sole_owner

pytestmark = pytest.mark.process

HOLD = """
import sys
from pathlib import Path
from twinct.core.files.lock import sole_owner
with sole_owner(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
print("done")
"""

TAKE_TURNS = """
import os, sys
from pathlib import Path
from twinct.core.errors import FolderInUseError, StorageError
from twinct.core.files.lock import sole_owner
lock, turns = Path(sys.argv[1]), 0
while turns < 200:
    try:
        with sole_owner(lock):
            os.close(os.open(lock.with_name("inside"), os.O_CREAT | os.O_EXCL))  # none else is in
            os.unlink(lock.with_name("inside"))
            turns += 1
    except FolderInUseError:
        pass
"""


@contextlib.contextmanager
def started(script: str, lock: Path, number: int) -> Iterator[list[subprocess.Popen[str]]]:
    """So many processes of a script; they are killed in the end."""
    with contextlib.ExitStack() as stack:
        processes: list[subprocess.Popen[str]] = []
        for _ in range(number):
            process = subprocess.Popen(
                [sys.executable, "-c", script, str(lock)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            processes.append(process)
        yield processes


def test_the_second_is_told_who_holds_it_and_a_dead_owner_gives_it_up(tmp_path: Path) -> None:
    lock = tmp_path / "twinct.lock"
    with started(HOLD, lock, 1) as (owner,):
        assert owner.stdout is not None and owner.stdout.readline() == "held\n"
        with pytest.raises(FolderInUseError, match=rf"process {owner.pid} on "), sole_owner(lock):
            pytest.fail("two owners")
        owner.send_signal(signal.SIGKILL)
        owner.wait(HANG_S)
        with sole_owner(lock):
            assert str(os.getpid()) in lock.read_text()
        assert not lock.exists()


def test_of_many_at_once_one_holds_it(tmp_path: Path) -> None:
    with started(HOLD, tmp_path / "twinct.lock", 6) as racers:
        # A line of the one, which holds it until its input ends; nothing of those who are refused.
        first = [racer.stdout.readline() for racer in racers if racer.stdout is not None]
        assert sorted(first) == 5 * [""] + ["held\n"]
        ends = [racer.communicate(timeout=HANG_S) for racer in racers]
    winners = [out for out, _ in ends if out == "done\n"]
    losers = [error for out, error in ends if not out and "FolderInUseError" in error]
    assert (len(winners), len(losers)) == (1, 5)


def test_no_two_hold_it_while_it_goes_from_hand_to_hand(tmp_path: Path) -> None:
    with started(TAKE_TURNS, tmp_path / "twinct.lock", 3) as racers:
        ends = [racer.communicate(timeout=HANG_S) for racer in racers]
    assert ends == 3 * [("", "")] and not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with (
        pytest.raises(StorageError, match=rf"^{tmp_path}: the disk is full"),
        sole_owner(tmp_path / "lock"),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    (tmp_path / "file").touch()
    with (
        pytest.raises(StorageError, match=r"file: cannot be written"),
        sole_owner(tmp_path / "file" / "lock"),
    ):
        pass
