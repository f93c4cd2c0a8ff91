"""The pool on Ray does what the pool of this machine does, on nodes that may be lost."""

from __future__ import annotations

import dataclasses
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pool_jobs as jobs
import pytest

from twinct.cluster import RayPool, local
from twinct.cluster.content import pack, unpack
from twinct.errors import InputError, LinkError, MemoryShortageError
from twinct.pool import Died, Done, Event, Failed, LocalPool, Pool, Work, each

GIB = 2**30
HERE = Path(__file__).parent


def finish(pool: Pool) -> dict[str, Event]:
    events: dict[str, Event] = {}
    while new := pool.wait():
        events |= {event.key: event for event in new}
    return events


def until(condition: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def alive(mark: str) -> list[str]:
    """Command lines of the processes that have a mark in their environment; zombies have none."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes()
            if words and mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append(words.replace(b"\0", b" ").decode())
        except OSError:
            continue
    return found


@pytest.fixture
def content(tmp_path: Path) -> Path:
    folder = tmp_path / "content"
    folder.mkdir()
    (folder / "a.txt").write_text("content")
    return folder


def test_content_has_its_new_name_and_nothing_else(content: Path, tmp_path: Path) -> None:
    unpack(pack(content), tmp_path / "there")
    unpack(pack(content / "a.txt"), tmp_path / "b.txt")
    assert (tmp_path / "there" / "a.txt").read_text() == "content"
    assert (tmp_path / "b.txt").read_text() == "content"
    assert {p.name for p in tmp_path.iterdir()} == {"content", "there", "b.txt"}


def test_what_no_pool_can_be_made_of_is_refused_before_ray_starts(monkeypatch) -> None:
    with pytest.raises(InputError) as caught:
        RayPool("local", name="a/b", threads=0, workers=0, memory_bytes=0)
    assert len(caught.value.problems) == 4
    with pytest.raises(InputError, match="somewhere:6379: no Ray answers.*HOST:PORT"):
        RayPool("somewhere:6379", name="study")
    with pytest.raises(InputError, match="nonsense: no Ray answers"):
        RayPool("nonsense", name="study")
    with socket.create_server(("127.0.0.1", 0)) as server:  # accepts, and says nothing
        monkeypatch.setattr("twinct.cluster.pool.ANSWER_S", 0.5)
        with pytest.raises(InputError, match="127.0.0.1:.*no Ray answers"):
            RayPool(f"127.0.0.1:{server.getsockname()[1]}", name="study")


def test_what_killed_processes_left_is_removed(monkeypatch) -> None:
    monkeypatch.setattr("twinct.cluster.local._PREFIX", f"pytest-{secrets.token_hex(8)}-")
    folders = [Path(f"/tmp/{local._PREFIX}{name}") for name in ("held", "left", "starting")]
    for folder in folders:
        folder.mkdir()
        if folder is not folders[2]:
            os.mkfifo(folder / "lifeline")
    writer = os.open(folders[0] / "lifeline", os.O_RDWR)
    local._sweep()
    assert [folder.exists() for folder in folders] == [True, False, True]
    os.close(writer)
    folders[2].rmdir()
    local._sweep()
    assert not folders[0].exists()


@pytest.mark.cluster
@pytest.mark.process
def test_one_pool_on_this_machine(tmp_path: Path, content: Path, monkeypatch, capfd) -> None:
    """All that needs no second node, on one Ray: it takes long to start."""
    monkeypatch.setenv("TWINCT_CACHE", str(tmp_path / "cache"))
    mark = f"TWINCT_POOL_TEST={secrets.token_hex(8)}"
    monkeypatch.setenv(*mark.split("="))
    with RayPool(None, name="study", workers=4, memory_bytes=8 * GIB) as pool:
        assert (pool.slots, pool.most_memory_bytes) == (4, 8 * GIB)
        assert _loopback_only(mark)

        (said,) = [e.value for e in each(pool, [Work("who", jobs.who, 0)]) if isinstance(e, Done)]
        assert said["main"] and said["threads"] == (1, "1", "1")
        assert said["folder"].parent == tmp_path / "cache" / "study"

        spans = [
            event.value
            for event in each(pool, [_three_gigabytes(key) for key in range(6)])
            if isinstance(event, Done)
        ]
        most = max(sum(a <= begun < b for a, b in spans) for begun, _ in spans)
        assert len(spans) == 6 and most == 2

        with LocalPool(tmp_path / "local", workers=2, memory_bytes=GIB) as own:
            assert _told(pool, content, tmp_path / "ray") == _told(own, content, tmp_path / "own")

        works = [Work(str(n), jobs.die_until, (tmp_path / str(n), n)) for n in (2, 3)]
        events = {event.key: event for event in each(pool, works)}
        two, three = events["2"], events["3"]
        assert isinstance(two, Done) and two.value == 2
        assert isinstance(three, Failed) and three.kind == "WorkerDied"

        with pytest.raises(InputError, match="one pool at a time"):
            RayPool(None, name="other")
        with pytest.raises(MemoryShortageError, match="9.00 GiB"):
            pool.submit(Work("work", jobs.double, 1, memory_bytes=9 * GIB))
        with pytest.raises(ValueError, match="not offered"):
            pool.submit(Work("work", jobs.double, 1, inputs=("nothing",)))

        nodes = pool._ray.nodes()
        gone = {**nodes[0], "NodeID": "5c" * (len(nodes[0]["NodeID"]) // 2)}
        with monkeypatch.context() as patch:  # as Ray tells it for seconds after a node's death
            patch.setattr(pool._ray, "nodes", lambda: [*nodes, gone])
            pool._compare()

        pool._terms = dataclasses.replace(pool._terms, versions="twinct 0.0")
        pool.submit(Work("work", jobs.double, 1))
        with pytest.raises(InputError, match=r"is refused: it has twinct .*needed: twinct 0\.0"):
            pool.wait()
        with pytest.raises(InputError, match=r"is refused: it has twinct .*needed: twinct 0\.0"):
            pool._compare()

        pool.submit(Work("busy", jobs.hold, 60.0))
        pool.close(clear=True)
    until(lambda: not alive(mark), 2.0)
    assert not list((tmp_path / "cache" / "study").iterdir())
    assert capfd.readouterr() == ("", "")


def _three_gigabytes(key: int) -> Work:
    return Work(str(key), jobs.interval, 1.0, memory_bytes=3 * GIB)


def _loopback_only(mark: str) -> bool:
    """Nothing of Ray's listens where other machines could reach it."""
    inodes = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                inodes |= {os.readlink(p) for p in (folder / "fd").iterdir()}
        except OSError:
            continue
    rows = [
        line.split()
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
    ]
    heard = [row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in inodes]
    assert len(heard) >= 4
    return all(address.partition(":")[0].endswith("0100007F") for address in heard)


def _told(pool: Pool, content: Path, out: Path) -> list[object]:
    """What comes of the same work, seconds and places apart."""
    pool.offer("folder", content)
    pool.offer("file", content / "a.txt")
    works = [Work(f"double {n}", jobs.double, n) for n in range(5)]
    works += [Work(f"fail {kind}", jobs.fail, kind) for kind in ("input", "sealed", "result")]
    works += [Work(f"read {n}", jobs.read, n, inputs=(n,)) for n in ("folder", "file")]
    works += [Work("write", jobs.write, "ab")]
    told: list[object] = []
    for event in sorted(each(pool, works), key=lambda event: event.key):
        if isinstance(event, Failed):
            told.append((event.key, event.kind, event.problems, event.trace))
        elif event.key.startswith("read"):
            told.append((event.key, Path(event.value[0]).name, event.value[1]))
        else:
            told.append((event.key, event.value))
        for name, parcel in event.parcels.items() if isinstance(event, Done) else ():
            parcel.save(out / name)
    told += [(str(p.relative_to(out)), p.is_file() and p.read_bytes()) for p in out.rglob("*")]
    return told


@pytest.mark.cluster
@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["SIGKILL", "SIGINT"])
def test_nothing_of_a_local_ray_outlives_its_driver(
    tmp_path: Path, number: signal.Signals, figure: Callable[[str], None]
) -> None:
    mark = f"TWINCT_POOL_TEST={secrets.token_hex(8)}"
    driver = subprocess.Popen(
        [sys.executable, str(HERE / "driver.py"), str(tmp_path)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env=os.environ | {"TWINCT_POOL_TEST": mark.partition("=")[2]},
    )
    until(lambda: len(list(tmp_path.glob("study/*/held-*"))) == 2 or bool(driver.poll()), 90.0)
    assert len(alive(mark)) > 5
    os.killpg(driver.pid, number)
    begun = time.monotonic()
    driver.wait()
    until(lambda: not alive(mark), 8.0)
    figure(f"{number.name}: no process left after {time.monotonic() - begun:.1f} s")


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch) -> Iterator[tuple[str, Callable[[str], None], int]]:
    """Address, what steers it, and its process group: a process of its own."""
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    process = subprocess.Popen(
        [sys.executable, str(HERE / "simulated.py"), str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        process_group=0,
        text=True,
    )
    stdin, stdout = process.stdin, process.stdout
    assert stdin is not None and stdout is not None

    def steer(word: str) -> None:
        print(word, file=stdin, flush=True)  # noqa: T201
        assert stdout.readline().strip() == word

    yield stdout.readline().strip(), steer, process.pid
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    stdin.close()
    stdout.close()


@pytest.mark.cluster
@pytest.mark.process
def test_nodes_come_and_go_and_a_cluster_may_be_lost(
    cluster, tmp_path: Path, content: Path
) -> None:
    address, steer, group = cluster
    with RayPool(address, name="study") as pool:
        assert pool.slots == 2
        pool.offer("folder", content)
        for key in "abcd":
            pool.submit(Work(key, jobs.read, "folder", inputs=("folder",)))
            pool.submit(Work(f"wait {key}", jobs.interval, 1.0))
        done = [event.value for event in finish(pool).values() if isinstance(event, Done)]
        read = {path: text for path, text in done if text == "content"}
        assert len(done) == 8 and set(read) <= {
            str(p.parent) for p in tmp_path.glob("*/study/*/inputs/*/content/a.txt")
        }

        for key in "wxyz":
            pool.submit(Work(key, jobs.write, key))
        written = finish(pool)
        assert list(tmp_path.glob("second/study/*/made-*"))
        for key in ("one", "two"):
            pool.submit(Work(key, jobs.hold, 5.0))
        until(lambda: len(list(tmp_path.glob("*/study/*/held-*"))) == 2, 10.0)
        steer("remove")
        events = finish(pool)
        (lost,) = [event for event in events.values() if isinstance(event, Died)]
        assert not lost.blamed and lost.how == "its node was lost"
        for key, event in written.items():
            assert isinstance(event, Done)
            event.parcels["folder"].save(tmp_path / key)
            assert (tmp_path / key / "deep" / "a.txt").read_text() == key
        steer("add")
        until(lambda: pool.slots == 2, 30.0)  # a dead node counts until it is missed
        works = [Work(key, jobs.interval, 1.0) for key in "abcd"]
        assert sum(isinstance(event, Done) for event in each(pool, works)) == 4

        pool.submit(Work("busy", jobs.interval, 60.0))
        os.killpg(group, signal.SIGKILL)
        with pytest.raises(LinkError, match="does not answer"):
            list(each(pool, [Work("late", jobs.double, 1)]))
    assert isinstance(written["w"], Done)
    with pytest.raises(ValueError, match="closed"):
        written["w"].parcels["file"].save(tmp_path / "late")
