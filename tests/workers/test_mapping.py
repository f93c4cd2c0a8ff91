"""Work after work: lazily, again after a death, given up after the third."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pool_jobs as jobs
import pytest

from twinct.core.errors import InputError, MemoryShortageError, TwinctError
from twinct.workers import Died, Done, Event, Failed, LocalPool, Work, map_over

GIB = 2**30


class Scripted:
    """A pool that tells what it was made to tell of each work, one after the other."""

    slots = 2

    def __init__(self, script: dict[str, list[Event]]) -> None:
        self.script = script
        self.waiting: list[str] = []
        self.most = 0

    def submit(self, work: Work) -> None:
        if work.memory_bytes > 10:
            raise MemoryShortageError(f"{work.key} needs more than 10 bytes")
        self.waiting.append(work.key)
        self.most = max(self.most, len(self.waiting))

    def wait(self, timeout_s: float | None = None) -> list[Event]:
        key = self.waiting.pop(0)
        told = self.script.get(key)
        return [told.pop(0) if told else Done(key, key, {}, 0.0)]


def work(key: str, memory_bytes: int = 0) -> Work:
    return Work(key, jobs.double, key, memory_bytes)


def test_little_is_under_way_at_a_time() -> None:
    pool, asked = Scripted({}), []

    def source() -> Iterator[Work]:
        for number in range(50):
            asked.append(number)
            yield work(str(number))

    results = map_over(None, source(), pool=pool)
    next(results)
    assert len(asked) == 4
    assert len(list(results)) == 49 and pool.most == 4


def test_blamed_deaths_count_and_others_do_not() -> None:
    lost, blamed = Died("a", "its node was lost", blamed=False), Died("a", "it was SIGKILL")
    done = Done("a", 1, {}, 0.0)
    pool = Scripted({"a": [lost] * 9 + [blamed, lost, blamed, done]})
    assert list(map_over(None, [work("a")], pool=pool)) == [done]
    pool = Scripted({"a": [blamed, lost, blamed, blamed, done]})
    (failed,) = map_over(None, [work("a")], pool=pool)
    problems = ("killed its worker 3 times: it was SIGKILL",)
    assert failed == Failed("a", "WorkerDied", problems, "", 0.0)


def test_too_much_memory_fails_at_once() -> None:
    first, second = map_over(None, [work("big", 11), work("b", 10)], pool=Scripted({}))
    assert isinstance(first, Failed) and first.kind == "MemoryShortageError"
    assert isinstance(second, Done)


def test_nothing_ready_waits_for_an_event_and_is_an_error_without_one() -> None:
    done: list[str] = []

    def source() -> Iterator[Work | None]:
        yield work("a")
        while "a" not in done:
            yield None
        yield work("b")
        yield None
        yield None

    with pytest.raises(ValueError, match="no work ready"):
        for event in map_over(None, source(), pool=Scripted({})):
            done.append(event.key)
    assert done == ["a", "b"]


@pytest.mark.process
def test_real_deaths_are_tried_again_three_times(tmp_path: Path) -> None:
    with LocalPool(tmp_path, workers=2, memory_bytes=GIB) as pool:
        two = Work("two", jobs.die_until, (tmp_path / "two", 2))
        three = Work("three", jobs.die_until, (tmp_path / "three", 3))
        events = {event.key: event for event in map_over(None, [two, three], pool=pool)}
    assert isinstance(events["two"], Done) and events["two"].value == 2
    failed = events["three"]
    assert isinstance(failed, Failed) and failed.kind == "WorkerDied"
    assert failed.problems == ("killed its worker 3 times: its worker was killed by SIGKILL",)


@pytest.mark.process
def test_a_map_keeps_the_order_and_raises_what_failed(tmp_path: Path) -> None:
    with LocalPool(tmp_path, workers=2, memory_bytes=GIB) as pool:
        os.mkfifo(pipe := tmp_path / "pipe")
        modes = ["r", "", "", "", "w"]  # the first ends when the last has begun
        calls = [(pipe, mode, number) for number, mode in enumerate(modes)]
        assert list(map_over(jobs.meet, calls, pool=pool)) == [0, 1, 2, 3, 4]
        unread = map_over(jobs.double, range(100), pool=pool)
        assert [next(unread) for _ in range(3)] == [0, 2, 4]
        assert list(map_over(jobs.double, ["a", "b"], pool=pool)) == ["aa", "bb"]
        with pytest.raises(InputError) as caught:
            list(map_over(jobs.fail, ["input"], pool=pool))
        assert caught.value.problems == ("one", "two")
        with pytest.raises(TwinctError, match="RuntimeError: other") as other:
            list(map_over(jobs.fail, ["other"], pool=pool))
        assert "in fail" in other.value.__notes__[0]
