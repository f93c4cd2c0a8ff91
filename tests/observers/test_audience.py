"""Observers are told in order, in threads of their own, and hold up nobody."""

from __future__ import annotations

import logging
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from waiting import HANG_S, until

from twinct.geometry import VolumeGrid
from twinct.observers import (
    Audience,
    Event,
    IterationDone,
    JointSample,
    Missed,
    Observer,
    Said,
    StageStep,
    audience,
    audience_of,
)
from twinct.recon.volume import Volume


@pytest.fixture(autouse=True)
def _last_words_take_as_long_as_they_take(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audience, "LAST_WORDS_S", HANG_S)


def said(text: str) -> Said:
    return Said(text, warning=False)


def sample(time_s: float) -> JointSample:
    nothing = np.zeros(0)
    return JointSample(time_s, (), nothing, nothing, nothing)


def test_everything_is_heard_in_order_in_another_thread() -> None:
    heard: list[tuple[str, Event]] = []
    with audience_of([lambda e: heard.append((threading.current_thread().name, e))]) as told:
        with told.stage("views", 3, 1) as step:
            step()
        told.say("done", warning=True)
    assert {name for name, _ in heard} == {"observer <lambda>"}
    kinds = [type(event).__name__ for _, event in heard]
    assert kinds == ["StageBegan", "StageStep", "StageEnded", "Said"]
    assert heard[1][1] == StageStep("views", 3, 2)
    assert heard[-1][1] == Said("done", warning=True)


def test_a_stage_that_breaks_says_so() -> None:
    heard: list[Event] = []
    with pytest.raises(KeyError), audience_of([heard.append]) as told, told.stage("views", 3):
        raise KeyError
    assert getattr(heard[-1], "broken", None) is True


def test_one_that_raises_is_logged_once_and_told_no_more(
    caplog: pytest.LogCaptureFixture,
) -> None:
    calls, heard = [], []

    def broken(event: Event) -> None:
        calls.append(event)
        raise RuntimeError("no such screen")

    with caplog.at_level(logging.ERROR), audience_of([broken, heard.append]) as told:
        told.say("0")
        told._seats[0]._thread.join(HANG_S)  # it has raised
        for k in range(1, 5):
            told.say(str(k))
        assert told.wants(Said)
        assert not told._seats[0]._queue
    assert len(calls) == 1
    assert [e.text for e in heard] == list("01234")
    assert [r.getMessage() for r in caplog.records] == [
        "observer broken failed and gets no more events"
    ]
    assert "no such screen" in caplog.text


def test_a_slow_one_holds_up_nobody_and_is_told_what_it_missed() -> None:
    began, go, heard, quick = threading.Event(), threading.Event(), [], []

    def slow(event: Event) -> None:
        began.set()
        go.wait()
        heard.append(event)

    with audience_of([Observer(slow, (Said,), waiting=3), quick.append]) as told:
        told.say("first")
        assert began.wait(HANG_S)
        for k in range(10):
            told.say(str(k))
        go.set()
    assert [e.text for e in quick] == ["first", *"0123456789"]
    assert heard == [said("first"), Missed({"Said": 7}, ()), *map(said, "789")]


def test_the_end_waits_for_a_slow_one() -> None:
    heard: list[Event] = []

    def slow(event: Event) -> None:
        until(lambda: told._seats[0]._ending, "the end of the run")
        heard.append(event)

    with audience_of([slow]) as told:
        for k in range(100):
            told.say(str(k))
    assert heard == [said(str(k)) for k in range(100)]


def test_the_end_waits_for_a_slow_one_but_not_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    began, never, heard = threading.Event(), threading.Event(), []
    times = iter([0.0, 2 * HANG_S])  # the end begins; the first of its two waits is over

    def slow(event: Event) -> None:
        began.set()
        if not isinstance(event, Missed):
            seat = told._seats[0]
            until(lambda: seat._ending and not seat._queue, "leaving out what it has not heard")
        heard.append(event)

    with monkeypatch.context() as patch, audience_of([slow]) as told:
        patch.setattr(audience, "time", SimpleNamespace(monotonic=lambda: next(times)))
        told.say("0")
        assert began.wait(HANG_S)
        for k in range(1, 100):
            told.say(str(k))
    assert heard == [said("0"), Missed({"Said": 99}, ())]

    monkeypatch.setattr(audience, "LAST_WORDS_S", 0.0)
    with audience_of([lambda event: never.wait()]) as told:
        told.say("0")
    assert told._seats[0]._thread.is_alive()  # and the end has come all the same
    never.set()


def test_a_lossless_one_makes_the_run_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audience, "LAST_WORDS_S", 0.0)
    heard: list[Event] = []
    ahead: list[int] = []

    def slow(event: Event) -> None:
        seat = told._seats[0]
        until(lambda: len(seat._queue) >= 2 or seat._ending, "the run has said as much as it can")
        heard.append(event)

    with audience_of([Observer(slow, waiting=2, lossless=True)]) as told:
        for k in range(20):
            told.say(str(k))
            ahead.append(k - len(heard))
    assert [e.text for e in heard] == [str(k) for k in range(20)]
    assert max(ahead) <= 2  # besides the one that is being heard


def test_joints_come_at_the_rate_that_is_asked_for() -> None:
    heard: list[JointSample] = []
    all_of_them: list[JointSample] = []
    with audience_of(
        [Observer(heard.append, joints_hz=10), Observer(all_of_them.append, joints_hz=50)]
    ) as told:
        for k in range(1, 101):
            told.tell(sample(sum([0.02] * k)))  # rounded as the simulation's time is
    assert len(all_of_them) == 100
    assert [e.time_s for e in heard[1:]] == pytest.approx(np.arange(1, 21) / 10)


def test_of_volumes_only_the_newest_waits() -> None:
    began, go, heard = threading.Event(), threading.Event(), []
    grid = VolumeGrid((2, 2, 2), 1.0)

    def slow(event: Event) -> None:
        began.set()
        go.wait()
        heard.append(event)

    with audience_of([slow]) as told:
        told.say("first")
        assert began.wait(HANG_S)
        for k in range(1, 5):
            volume = Volume(np.full((2, 2, 2), k, np.float32), grid)
            told.tell(IterationDone("sart", "believed", k, 4, 0.0, volume))
        go.set()
    assert heard[1] == Missed({"IterationDone": 3}, ())
    assert [e.iteration for e in heard[2:]] == [4]


def test_an_audience_that_is_handed_on_stays_open() -> None:
    heard: list[Event] = []
    with audience_of([heard.append]) as outer:
        with audience_of(outer) as inner:
            assert inner is outer
        outer.say("still here")
    assert heard == [said("still here")]
    assert not Audience().wants(Said)
