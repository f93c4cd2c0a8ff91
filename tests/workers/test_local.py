"""A pool of this machine's processes: who works when, what comes back, and what dies with whom."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pool_jobs as jobs
import pytest
from waiting import HANG_S, Patience, until

from twinct.core.errors import InputError, MemoryShortageError
from twinct.workers import Died, Done, Event, Failed, LocalPool, Work

GIB = 2**30


@pytest.fixture
def pool(tmp_path: Path) -> Iterator[LocalPool]:
    with LocalPool(tmp_path / "node", workers=2, memory_bytes=8 * GIB) as pool:
        yield pool


def finish(pool: LocalPool) -> dict[str, Event]:
    events: dict[str, Event] = {}
    while new := pool.wait():
        events |= {event.key: event for event in new}
    return events


@contextlib.contextmanager
def ended_at_last(*numbers: int) -> Iterator[None]:
    """Processes that are no children of this one are killed, whatever comes of the test."""
    try:
        yield
    finally:
        for pid in numbers:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def gone(pid: int) -> bool:
    """It lives no more; what nobody waits for may stay in the table."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.process
def test_workers_are_few_warm_bounded_and_work_in_their_main_thread(
    pool: LocalPool, tmp_path: Path
) -> None:
    for key in range(6):  # the pool hears of an end in wait() alone: the second has its own worker
        pool.submit(Work(str(key), jobs.who, None))
    said = [event.value for event in finish(pool).values() if isinstance(event, Done)]
    assert len(said) == 6
    assert len({s["process"] for s in said}) == 2
    assert all(s["main"] and s["threads"] == (1, "1", "1") for s in said)
    assert all(s["folder"] == tmp_path / "node" for s in said)
    for key in range(6):  # one after the other: one warm worker does them all
        pool.submit(Work(str(key), jobs.who, None))
        said += [event.value for event in finish(pool).values() if isinstance(event, Done)]
    assert len(said) == 12 and len({s["process"] for s in said[6:]}) == 1


@pytest.mark.process
def test_three_gigabytes_each_of_eight_are_never_more_than_two(tmp_path: Path) -> None:
    with LocalPool(tmp_path, workers=4, memory_bytes=8 * GIB) as pool:
        for key in range(6):
            pool.submit(Work(str(key), jobs.who, None, memory_bytes=3 * GIB))
        said = [e.value for e in finish(pool).values() if isinstance(e, Done)]
    # A worker is started whenever there is work that may start, and none is free.
    assert len(said) == 6 and len({s["process"] for s in said}) == 2


@pytest.mark.process
def test_small_work_passes_what_waits_for_memory_but_not_for_ever(tmp_path: Path) -> None:
    with (
        jobs.gate_at(tmp_path / "gate") as gate,
        LocalPool(tmp_path / "node", workers=2, memory_bytes=4) as pool,
    ):
        pool.submit(Work("first", jobs.gated, (gate, "first", jobs.double, 1), memory_bytes=3))
        pool.submit(Work("big", jobs.double, 1, memory_bytes=4))
        for key in range(40):
            pool.submit(Work(str(key), jobs.double, 1, memory_bytes=1))
        passed: list[str] = []
        while len(passed) < 16:
            passed += [event.key for event in pool.wait(HANG_S)] or pytest.fail("nothing passes")
        gate.open()
        order = [*passed, *finish(pool)]
    # One at a time passes beside the first, so that they end in the order in which they began.
    assert order[:18] == [*map(str, range(16)), "first", "big"] and len(order) == 42


@pytest.mark.process
def test_an_idle_worker_is_ended_if_its_memory_may_be_needed(tmp_path: Path) -> None:
    with LocalPool(tmp_path, workers=2, memory_bytes=GIB) as pool:
        for key in "ab":
            pool.submit(Work(key, jobs.grow, GIB // 4, memory_bytes=GIB // 2))
        grown = {e.value for e in finish(pool).values() if isinstance(e, Done)}
        pool.submit(Work("small", jobs.who, None, memory_bytes=GIB // 2))
        assert len(grown) == 2 and isinstance(finish(pool)["small"], Done)
        assert not any(gone(pid) for pid in grown)
        pool.submit(Work("big", jobs.who, None, memory_bytes=GIB))
        big = finish(pool)["big"]
        assert isinstance(big, Done) and {pid for pid in grown if not gone(pid)} == {
            big.value["process"]
        }


@pytest.mark.process
def test_what_fails_is_told_and_no_worker_dies_of_it(pool: LocalPool) -> None:
    kinds = ("input", "meant", "sealed", "result", "exit", "missing", "other")
    for kind in kinds:
        pool.submit(Work(kind, jobs.fail, kind))
    failed = finish(pool)
    assert all(isinstance(failed[kind], Failed) for kind in kinds)
    told = {k: (e.kind, e.problems, bool(e.trace)) for k, e in failed.items() if type(e) is Failed}
    assert told["input"] == ("InputError", ("one", "two"), False)
    assert told["meant"] == ("MotionError", ("arms stand still",), False)
    assert told["sealed"] == ("Sealed", ("by whom",), True)
    assert told["result"][2] and "lambda" in told["result"][1][0]
    assert told["exit"] == ("SystemExit", ("3",), True)
    assert told["missing"][0] == "FileNotFoundError"
    assert told["other"] == ("RuntimeError", ("other",), True)


@pytest.mark.process
def test_a_death_is_told_with_its_signal_and_the_next_work_is_done(
    pool: LocalPool, tmp_path: Path
) -> None:
    pool.submit(Work("dies", jobs.die_until, (tmp_path / "count", 1)))
    pool.submit(Work("lives", jobs.double, 21))
    events = finish(pool)
    assert events["dies"] == Died("dies", "its worker was killed by SIGKILL")
    pool.submit(Work("dies", jobs.die_until, (tmp_path / "count", 1)))
    for event, value in ((events["lives"], 42), (finish(pool)["dies"], 1)):
        assert isinstance(event, Done) and event.value == value


@pytest.mark.process
def test_what_a_dead_worker_started_ends_with_it(pool: LocalPool, tmp_path: Path) -> None:
    pool.submit(Work("leaves", jobs.leave, tmp_path / "child"))
    events = finish(pool)
    child = int((tmp_path / "child").read_text())
    with ended_at_last(child):
        assert events["leaves"] == Died("leaves", "its worker exited with code 7")
        until(lambda: gone(child))


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["SIGKILL", "SIGINT"])
def test_workers_that_hold_the_interpreter_end_with_their_driver(
    tmp_path: Path, number: signal.Signals, figure: Callable[[str], None]
) -> None:
    here = Path(__file__).parent
    driver = subprocess.Popen(
        [sys.executable, str(here / "driver.py"), str(tmp_path)],
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    with driver, ended_at_last(driver.pid):
        until(lambda: len(list(tmp_path.glob("held-*"))) == 2 or driver.poll() is not None)
        held = list(tmp_path.glob("held-*"))
        workers = [int(path.name.partition("-")[2]) for path in held]
        processes = [*workers, *(int(path.read_text()) for path in held)]
        with ended_at_last(*processes):
            assert len(processes) == 4 and not any(gone(pid) for pid in processes)
            os.killpg(driver.pid, number)
            patience = Patience()
            until(lambda: all(gone(pid) for pid in processes))
            figure(f"{number.name}: no process left after {HANG_S - patience.left_s:.2f} s")
            assert driver.wait(HANG_S) == -number


@pytest.mark.process
@pytest.mark.parametrize("held", [True, False])
def test_a_lifeline_that_was_cut_before_is_noticed(tmp_path: Path, held: bool) -> None:
    """A named pipe that nobody writes to looks like one whose writer is idle."""
    pipe = tmp_path / "lifeline"
    os.mkfifo(pipe)
    writer = os.open(pipe, os.O_RDWR) if held else None
    program = (
        "import os, sys; from twinct.workers.lifeline import end_with; "
        "end_with(os.open(sys.argv[1], os.O_RDONLY | os.O_NONBLOCK))"
    )
    done = subprocess.run([sys.executable, "-c", program, str(pipe)], process_group=0)
    assert done.returncode == (0 if held else -signal.SIGKILL)
    if writer is not None:
        os.close(writer)


@pytest.mark.process
def test_close_ends_busy_workers_and_clears_the_folder(pool: LocalPool, tmp_path: Path) -> None:
    pool.submit(Work("busy", jobs.hold, None))
    until(lambda: bool(list(pool.folder.glob("held-*"))))
    worker = int(next(pool.folder.glob("held-*")).name.partition("-")[2])
    pool.close(clear=True)
    assert gone(worker) and not pool.folder.exists()
    assert pool.wait() == []
    with pytest.raises(ValueError, match="closed"):
        pool.submit(Work("late", jobs.double, 1))


@pytest.mark.process
def test_contents_come_from_where_they_were_offered_and_go_where_they_are_saved(
    pool: LocalPool, tmp_path: Path
) -> None:
    source = tmp_path / "source.txt"
    source.write_text("content")
    pool.offer("text", source)
    pool.submit(Work("read", jobs.read, "text", inputs=("text",)))
    pool.submit(Work("not named", jobs.read, "text"))
    pool.submit(Work("write", jobs.write, "ab"))
    events = finish(pool)
    read, unnamed, written = (events[key] for key in ("read", "not named", "write"))
    assert isinstance(read, Done) and read.value == (str(source), "content")
    assert isinstance(unnamed, Failed) and unnamed.kind == "KeyError"
    assert isinstance(written, Done) and set(written.artifacts) == {"folder", "file"}
    for _ in range(2):  # again: it takes the place of what is there
        pool.save(written, "folder", tmp_path / "out" / "folder")
        pool.save(written, "file", tmp_path / "out" / "file.txt")
    assert (tmp_path / "out" / "folder" / "deep" / "a.txt").read_text() == "ab"
    assert (tmp_path / "out" / "file.txt").read_text() == "abab"
    made = pool.folder / "made-ab" / "b.txt"
    assert os.path.samefile(tmp_path / "out" / "folder" / "b.txt", made)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["file.txt", "folder"]
    pool.withdraw("text")
    with pytest.raises(ValueError, match="not offered.*text"):
        pool.submit(Work("again", jobs.read, "text", inputs=("text",)))


def test_what_cannot_be_sent_is_refused_before_anything_starts(pool: LocalPool) -> None:
    def local(argument: object, place: object) -> None: ...

    def main(argument: object, place: object) -> None: ...

    main.__module__ = "__main__"
    for function, problem in ((main, "__main__"), (local, "the function must be")):
        with pytest.raises(InputError, match=problem):
            pool.submit(Work("work", function, None))
    with pytest.raises(InputError, match="__main__"):
        pool.submit(Work("work", jobs.double, [main]))
    with pytest.raises(MemoryShortageError, match="9.00 GiB.*8.00 GiB"):
        pool.submit(Work("work", jobs.double, 1, memory_bytes=9 * GIB))


def test_a_pool_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        LocalPool(tmp_path, workers=0, threads=0, memory_bytes=0)
    assert len(caught.value.problems) == 3
    assert LocalPool(tmp_path, workers=1).most_memory_bytes > 0
