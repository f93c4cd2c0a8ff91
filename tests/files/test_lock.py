"""A folder has one owner, and a dead one's lock is free."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.errors import FolderInUseError
from twinct.files.lock import sole_owner

pytestmark = pytest.mark.process

HOLD = """
import sys, time
from pathlib import Path
from twinct.files.lock import sole_owner
with sole_owner(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_the_second_is_told_who_holds_it_and_a_dead_owner_gives_it_up(tmp_path: Path) -> None:
    lock = tmp_path / "twinct.lock"
    owner = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(lock)], stdout=subprocess.PIPE, text=True
    )
    assert owner.stdout is not None and owner.stdout.readline() == "held\n"
    with pytest.raises(FolderInUseError, match=rf"process {owner.pid} on "), sole_owner(lock):
        pytest.fail("two owners")
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    with sole_owner(lock):
        assert str(os.getpid()) in lock.read_text()
    assert not lock.exists()


def test_of_many_at_once_one_holds_it(tmp_path: Path) -> None:
    script = HOLD.replace("time.sleep(60)", "time.sleep(0.05); print('done', flush=True)")
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path / "twinct.lock")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(6)
    ]
    ends = [racer.communicate() for racer in racers]
    winners = [out for out, _ in ends if out == "held\ndone\n"]
    losers = [error for out, error in ends if not out and "FolderInUseError" in error]
    assert winners and len(winners) + len(losers) == len(racers)
