"""The pool on Ray does what the pool of this machine does, on nodes that may be lost."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pool_jobs as jobs
import pytest
from waiting import HANG_S, Patience, until

from twinct.core.errors import InputError, LinkError, MemoryShortageError
from twinct.workers import Died, Done, Event, Failed, LocalPool, Pool, Work
from twinct.workers.cluster import RayPool, local
from twinct.workers.cluster.content import pack, unpack

GIB = 2**30
HERE = Path(__file__).parent


def finish(pool: Pool) -> dict[str, Event]:
    events: dict[str, Event] = {}
    while new := pool.wait():
        events |= {event.key: event for event in new}
    return events


MARK = "TWINCT_POOL_TEST"


def alive(folder_of_test: Path) -> dict[int, str]:
    """Processes that have a test's mark in their environment, and their command lines.

    Zombies have none.
    """
    mark, found = f"{MARK}={folder_of_test}", dict[int, str]()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes()
            if words and mark.encode() in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = words.replace(b"\0", b" ").decode()
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


def test_what_no_pool_can_be_made_of_is_refused_before_ray_starts() -> None:
    with pytest.raises(InputError) as caught:
        RayPool("local", name="a/b", threads=0, workers=0, memory_bytes=0)
    assert len(caught.value.problems) == 4
    with pytest.raises(InputError, match="somewhere:6379: no Ray answers.*HOST:PORT"):
        RayPool("somewhere:6379", name="study")
    with pytest.raises(InputError, match="nonsense: no Ray answers"):
        RayPool("nonsense", name="study")


JOIN = """
import sys
from twinct.core.errors import InputError
from twinct.workers.cluster import RayPool
try:
    RayPool(sys.argv[1], name="study")
except InputError as error:
    print(error)
try:
    RayPool("local", name="study")
except InputError as error:
    print(error)
"""


@pytest.mark.cluster
@pytest.mark.process
def test_a_server_without_ray_is_refused_and_a_token_comes_before_ray() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:  # accepts, and says nothing
        address = f"127.0.0.1:{server.getsockname()[1]}"
        done = subprocess.run(
            [sys.executable, "-c", JOIN, address],
            capture_output=True,
            text=True,
            timeout=HANG_S,
            env=without_token() | {"RAY_gcs_rpc_server_connect_timeout_s": "1"},
        )
    joined, local = done.stdout.splitlines()
    assert joined.startswith(f"{address}: cannot connect to the Ray there")
    assert "imported before RAY_AUTH_MODE could be set" in local and not done.stderr


def without_token() -> dict[str, str]:
    """The environment of a driver that has no token."""
    return {name: value for name, value in os.environ.items() if "RAY_AUTH" not in name}


@pytest.mark.cluster
@pytest.mark.process
def test_one_pool_on_this_machine(tmp_path: Path, content: Path, monkeypatch, capfd) -> None:
    """All that needs no second node, on one Ray: it takes long to start."""
    monkeypatch.setenv("TWINCT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv(MARK, str(tmp_path))
    ran = tmp_path / "ran"
    strangers = tmp_path / "strangers"  # Ray's workers would import from the current folder
    strangers.mkdir()
    for name in ("numpy", "twinct", "pool_jobs"):
        (strangers / f"{name}.py").write_text(
            f"import os\nos.makedirs({str(ran)!r}, exist_ok=True)"
        )
    monkeypatch.chdir(strangers)
    with RayPool(None, name="study", workers=4, memory_bytes=8 * GIB) as pool:
        assert Path.cwd() == strangers
        assert (pool.slots, pool.most_memory_bytes) == (4, 8 * GIB)
        assert _loopback_only(tmp_path)

        (said,) = [e.value for e in pool.results([Work("who", jobs.who, 0)]) if isinstance(e, Done)]
        assert said["main"] and said["threads"] == (1, "1", "1") and not ran.exists()
        assert said["folder"].parent == tmp_path / "cache" / "study"

        with jobs.gate_at(tmp_path / "gate") as gate:
            for key in ("3 a", "3 b", "3 c", "3 d", "3 e", "3 f"):
                pool.submit(_at(gate, key, memory_bytes=3 * GIB))
            until(lambda: len(gate.come) >= 2)
            # What fits beside two of them comes, and of the others none.
            pool.submit(_at(gate, "2", memory_bytes=2 * GIB))
            until(lambda: "2" in gate.come or len(gate.come) > 2)
            assert len(gate.come) == 3 and "2" in gate.come
            gate.open()
            events = finish(pool)
            assert [e for e in events.values() if not isinstance(e, Done)] == []
            assert len(events) == 7

        with LocalPool(tmp_path / "local", workers=2, memory_bytes=GIB) as own:
            assert _told(pool, content, tmp_path / "ray") == _told(own, content, tmp_path / "own")

        works = [Work(str(n), jobs.die_until, (tmp_path / str(n), n)) for n in (2, 3)]
        events = {event.key: event for event in pool.results(works)}
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

        pool.submit(Work("busy", jobs.hold, None))
        pool.close(clear=True)
    until(lambda: not alive(tmp_path))
    assert not list((tmp_path / "cache" / "study").iterdir())
    assert capfd.readouterr() == ("", "")


def _at(gate: jobs.Gate, key: str, memory_bytes: int = 0) -> Work:
    """Work that lasts until the gate is open."""
    return Work(key, jobs.gated, (gate, key, jobs.double, 1), memory_bytes)


def _loopback_only(folder_of_test: Path) -> bool:
    """Nothing of Ray's listens where other machines could reach it."""
    inodes = set()
    for pid in alive(folder_of_test):
        with contextlib.suppress(OSError):
            inodes |= {os.readlink(path) for path in Path(f"/proc/{pid}/fd").iterdir()}
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
    for event in sorted(pool.results(works), key=lambda event: event.key):
        if isinstance(event, Failed):
            told.append((event.key, event.kind, event.problems, event.trace))
        elif event.key.startswith("read"):
            told.append((event.key, Path(event.value[0]).name, event.value[1]))
        else:
            told.append((event.key, event.value))
        if isinstance(event, Done):
            for name in event.artifacts:
                pool.save(event, name, out / name)
    told += [(str(p.relative_to(out)), p.is_file() and p.read_bytes()) for p in out.rglob("*")]
    return told


def test_ray_is_started_again_if_it_gives_up_too_early(monkeypatch: pytest.MonkeyPatch) -> None:
    problems: list[Exception] = [local.GaveUpError("slow"), LinkError("no such option")]

    def fail(processors: int, memory_bytes: int) -> None:
        raise problems.pop(0)

    monkeypatch.setattr(local, "LocalRay", fail)
    with pytest.raises(LinkError, match="no such option"):
        local.start(1, 2**30)
    problems[:] = [local.GaveUpError("slow")]
    monkeypatch.setattr(local, "PATIENCE_S", -1.0)
    with pytest.raises(LinkError, match="slow"):
        local.start(1, 2**30)


@pytest.mark.cluster
@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["SIGKILL", "SIGINT"])
def test_nothing_of_a_local_ray_outlives_its_driver(
    tmp_path: Path, number: signal.Signals, figure: Callable[[str], None]
) -> None:
    driver = subprocess.Popen(
        [sys.executable, str(HERE / "driver.py"), str(tmp_path)],
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env=without_token() | {MARK: str(tmp_path)},
    )
    try:
        held = Path("study").joinpath("*", "held-*")
        until(lambda: len(list(tmp_path.glob(str(held)))) == 2 or driver.poll() is not None)
        assert len(alive(tmp_path)) > 5
        os.killpg(driver.pid, number)
        patience = Patience()
        driver.wait(HANG_S)
        until(lambda: not alive(tmp_path))
        figure(f"{number.name}: no process left after {HANG_S - patience.left_s:.1f} s")
    finally:
        for pid in alive(tmp_path):
            os.kill(pid, signal.SIGKILL)
        driver.wait()


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch) -> Iterator[tuple[str, Callable[[str], None], int]]:
    """Address, what steers it, and its process group: a process of its own."""
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
    with (
        jobs.gate_at(tmp_path / "read") as reading,
        jobs.gate_at(tmp_path / "write") as writing,
        jobs.gate_at(tmp_path / "lose") as losing,
        jobs.gate_at(tmp_path / "again") as again,
        jobs.gate_at(tmp_path / "last") as last,
        RayPool(address, name="study") as pool,
    ):
        assert pool.slots == 2
        pool.offer("folder", content)
        for key in "abcd":
            pool.submit(Work(key, jobs.read, "folder", inputs=("folder",)))
            pool.submit(_at(reading, f"wait {key}"))
        until(lambda: len(reading.come) == 2)  # one on each node
        reading.open()
        done = [event.value for event in finish(pool).values() if isinstance(event, Done)]
        read = {value[0] for value in done if value != 2}
        assert len(done) == 8 and read <= {
            str(p.parent) for p in tmp_path.glob("*/study/*/inputs/*/content/a.txt")
        }

        for key in "wxyz":
            pool.submit(Work(key, jobs.gated, (writing, key, jobs.write, key)))
        until(lambda: len(writing.come) == 2)
        writing.open()
        written = finish(pool)
        assert list(tmp_path.glob("second/study/*/made-*"))
        for key in ("one", "two"):
            pool.submit(_at(losing, key))
        until(lambda: len(losing.come) == 2)
        steer("remove")
        (lost,) = pool.wait(HANG_S)
        assert isinstance(lost, Died) and not lost.blamed and lost.how == "its node was lost"
        losing.open()
        assert [isinstance(event, Done) for event in finish(pool).values()] == [True]
        for key, event in written.items():
            assert isinstance(event, Done)
            pool.save(event, "folder", tmp_path / key)
            assert (tmp_path / key / "deep" / "a.txt").read_text() == key
        steer("add")
        until(lambda: pool.slots == 2)  # a dead node counts until it is missed
        for key in "abcd":
            pool.submit(_at(again, key))
        until(lambda: len(again.come) == 2)  # the new node works, too
        again.open()
        assert [isinstance(event, Done) for event in finish(pool).values()] == 4 * [True]

        pool.submit(_at(last, "busy"))
        os.killpg(group, signal.SIGKILL)
        with pytest.raises(LinkError, match="does not answer"):
            list(pool.results([Work("late", jobs.double, 1)]))
    assert isinstance(written["w"], Done)
    with pytest.raises(ValueError, match="closed"):
        pool.save(written["w"], "file", tmp_path / "late")
