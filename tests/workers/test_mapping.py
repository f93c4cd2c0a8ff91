"""Work after work: lazily, again after a death, given up after the third."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pool_jobs as jobs
import pytest

from twinct.core.errors import InputError, TwinctError
from twinct.workers import Died, Done, Event, Failed, LocalPool, Pool, Work

GIB = 2**30


class Scripted(Pool):
    """A pool that tells what it was made to tell of each work, one after the other."""

    def __init__(self, script: dict[str, list[Any]]) -> None:
        super().__init__()
        self.script = script
        self.waiting: list[str] = []
        self.most = 0

    @property
    def slots(self) -> int:
        return 2

    @property
    def most_memory_bytes(self) -> int:
        return 10

    def _start(self, work: Work, request: bytes) -> None:
        self.waiting.append(work.key)
        self.most = max(self.most, len(self.waiting))

    def _events(self, timeout_s: float | None) -> list[Event]:
        key = self.waiting.pop(0)
        told = self.script.get(key)
        return [told.pop(0) if told else Done(key, key, {}, 0.0)]

    def save(self, done: Done, name: str, path: Path) -> None: ...

    def close(self, *, clear: bool = False) -> None: ...


def work(key: str, memory_bytes: int = 0) -> Work:
    return Work(key, jobs.double, key, memory_bytes)


def test_little_is_under_way_at_a_time() -> None:
    pool, asked = Scripted({}), []

    def source() -> Iterator[Work]:
        for number in range(50):
            asked.append(number)
            yield work(str(number))

    results = pool.results(source())
    next(results)
    assert len(asked) == 4
    assert len(list(results)) == 49 and pool.most == 4


def test_blamed_deaths_count_and_others_do_not() -> None:
    lost, blamed = Died("a", "its node was lost", blamed=False), Died("a", "it was SIGKILL")
    done = Done("a", 1, {}, 0.0)
    pool = Scripted({"a": [lost] * 9 + [blamed, lost, blamed, done]})
    assert list(pool.results([work("a")])) == [done]
    pool = Scripted({"a": [blamed, lost, blamed, blamed, done]})
    (failed,) = pool.results([work("a")])
    problems = ("killed its worker 3 times: it was SIGKILL",)
    assert failed == Failed("a", "WorkerDied", problems, "", 0.0)


def test_too_much_memory_fails_at_once() -> None:
    first, second = Scripted({}).results([work("big", 11), work("b", 10)])
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
        for event in Scripted({}).results(source()):
            done.append(event.key)
    assert done == ["a", "b"]


@pytest.mark.process
def test_real_deaths_are_tried_again_three_times(tmp_path: Path) -> None:
    with LocalPool(tmp_path, workers=2, memory_bytes=GIB) as pool:
        two = Work("two", jobs.die_until, (tmp_path / "two", 2))
        three = Work("three", jobs.die_until, (tmp_path / "three", 3))
        events = {event.key: event for event in pool.results([two, three])}
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
        assert list(pool.map(jobs.meet, calls)) == [0, 1, 2, 3, 4]
        unread = pool.map(jobs.double, range(100))
        assert [next(unread) for _ in range(3)] == [0, 2, 4]
        assert list(pool.map(jobs.double, ["a", "b"])) == ["aa", "bb"]
        with pytest.raises(InputError) as caught:
            list(pool.map(jobs.fail, ["input"]))
        assert caught.value.problems == ("one", "two")
        with pytest.raises(TwinctError, match="RuntimeError: other") as other:
            list(pool.map(jobs.fail, ["other"]))
        assert "in fail" in other.value.__notes__[0]
