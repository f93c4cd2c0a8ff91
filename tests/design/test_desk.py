"""A desk answers the newest question, and its worker can be killed at any time."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest
from waiting import HANG_S, until

from twinct.core.errors import InputError
from twinct.design.bench import Bench
from twinct.design.desk import Answer, Desk, State
from twinct.design.questions import Question
from twinct.scenario import ScenarioText

pytestmark = pytest.mark.process

HERE = ScenarioText(Path("here.yaml"), "seed: 1")
CHANGED = ScenarioText(Path("here.yaml"), "seed: 2")


@dataclass(frozen=True)
class Said(Question):
    """Answers with a word; waits first until a file is there."""

    word: str = ""
    after: str = ""
    began: str = ""
    subject: ClassVar[str] = "word"

    def answered(self, bench: Bench) -> Any:
        if self.began:
            Path(self.began).write_text(str(os.getpid()))
        if self.after:
            until(Path(self.after).exists, "the file does not come")
        if self.word == "no":
            raise InputError("no: this word is not allowed")
        return f"{self.word} {os.getpid()}" if self.word == "pid" else self.word


@dataclass(frozen=True)
class Other(Said):
    subject: ClassVar[str] = "other"


class Heard:
    def __init__(self) -> None:
        self.all: list[tuple[str, Answer]] = []

    def __call__(self, subject: str, answer: Answer) -> None:
        self.all.append((subject, answer))

    def states(self, subject: str = "word") -> list[State]:
        return [answer.state for name, answer in self.all if name == subject]


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def now() -> list[float]:
    """The desk's clock."""
    return [0.0]


@pytest.fixture
def desk(tmp_path: Path, heard: Heard, now: list[float]) -> Iterator[Desk]:
    with closing(Desk(tmp_path, heard, clock=lambda: now[0])) as made:
        yield made


def ready(desk: Desk) -> None:
    assert desk.settle(HANG_S)


def busy(path: Path) -> Callable[[], bool]:
    return lambda: path.exists() and bool(path.read_text())


def test_an_answer_is_fresh_and_becomes_old(desk: Desk, heard: Heard) -> None:
    assert desk.answer("word") == Answer()
    desk.ask(Said(HERE, "yes"))
    ready(desk)
    found = desk.answer("word")
    assert (found.state, found.value, found.question) == (State.FRESH, "yes", Said(HERE, "yes"))
    desk.outdate("word")
    assert (desk.answer("word").state, desk.answer("word").value) == (State.OLD, "yes")
    assert heard.states() == [State.COMPUTING, State.FRESH, State.OLD]


def test_a_refusal_says_why_and_keeps_the_last_value(desk: Desk) -> None:
    desk.ask(Said(HERE, "yes"))
    ready(desk)
    desk.ask(Said(HERE, "no"))
    ready(desk)
    found = desk.answer("word")
    assert (found.state, found.value) == (State.FAILED, "yes")
    assert found.problems == ("no: this word is not allowed",)


def test_a_newer_question_replaces_those_that_wait(
    desk: Desk, tmp_path: Path, heard: Heard
) -> None:
    gate, began = tmp_path / "gate", tmp_path / "began"
    desk.ask(Other(HERE, "first", str(gate), str(began)))
    until(busy(began), "it does not begin")
    for word in ("a", "b", "c"):
        desk.ask(Said(HERE, word))
    gate.touch()
    ready(desk)
    assert desk.answer("other").value == "first"
    values = [a.value for name, a in heard.all if name == "word" and a.state is State.FRESH]
    assert values == ["c"]


def test_the_running_question_may_finish_and_its_answer_is_not_the_newest(
    desk: Desk, tmp_path: Path, heard: Heard
) -> None:
    gate, began = tmp_path / "gate", tmp_path / "began"
    desk.ask(Said(HERE, "earlier", str(gate), str(began)))
    until(busy(began), "it does not begin")
    desk.ask(Said(CHANGED, "newer"))
    gate.touch()
    ready(desk)
    assert desk.answer("word").value == "newer"
    seen = [(a.state, a.value) for name, a in heard.all if name == "word"]
    assert (State.COMPUTING, "earlier") in seen and (State.FRESH, "earlier") not in seen


def test_a_worthless_question_is_killed_when_the_patience_ends(
    desk: Desk, tmp_path: Path, now: list[float]
) -> None:
    began = tmp_path / "began"
    desk.ask(Said(HERE, "never", str(tmp_path / "never"), str(began)))
    until(busy(began), "it does not begin")
    desk.ask(Said(CHANGED, "pid"))
    now[0] = desk.patience_s + 1
    ready(desk)
    assert desk.answer("word").value not in ("never", f"pid {began.read_text()}")
    assert desk.answer("word").state is State.FRESH


def test_cancelling_kills_the_worker_and_the_next_question_starts_another(
    desk: Desk, tmp_path: Path
) -> None:
    began = tmp_path / "began"
    desk.ask(Said(HERE, "never", str(tmp_path / "never"), str(began)))
    until(busy(began), "it does not begin")
    desk.ask(Other(HERE, "waits"))
    desk.cancel()
    ready(desk)
    assert desk.answer("word").state is desk.answer("other").state is State.OLD
    desk.ask(Said(HERE, "yes"))
    ready(desk)
    assert desk.answer("word").value == "yes"


def test_a_killed_worker_fails_its_question_only(desk: Desk, tmp_path: Path) -> None:
    began = tmp_path / "began"
    desk.ask(Said(HERE, "never", str(tmp_path / "never"), str(began)))
    until(busy(began), "it does not begin")
    os.kill(int(began.read_text()), signal.SIGKILL)
    ready(desk)
    assert desk.answer("word").state is State.FAILED
    assert desk.answer("word").problems == ("its worker was killed by SIGKILL",)
    desk.ask(Said(HERE, "yes"))
    ready(desk)
    assert desk.answer("word").state is State.FRESH


def test_an_outdated_running_question_gives_an_old_answer(desk: Desk, tmp_path: Path) -> None:
    gate, began = tmp_path / "gate", tmp_path / "began"
    desk.ask(Said(HERE, "yes", str(gate), str(began)))
    until(busy(began), "it does not begin")
    desk.outdate("word")
    gate.touch()
    ready(desk)
    assert (desk.answer("word").state, desk.answer("word").value) == (State.OLD, "yes")


def test_closing_ends_a_busy_worker(tmp_path: Path, heard: Heard) -> None:
    began = tmp_path / "began"
    desk = Desk(tmp_path / "desk", heard)
    desk.ask(Said(HERE, "never", str(tmp_path / "never"), str(began)))
    until(busy(began), "it does not begin")
    desk.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int(began.read_text()), 0)
