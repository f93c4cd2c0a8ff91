"""A pool of processes on the machines that Ray has."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from twinct.cluster import node
from twinct.cluster.content import Bytes, pack, unpack
from twinct.cluster.local import CLIENT, ENVIRONMENT, LocalRay
from twinct.errors import InputError, LinkError, MemoryShortageError
from twinct.extras import require
from twinct.memory import available_bytes
from twinct.pool.call import Outcome, event, sent
from twinct.pool.parcel import arriving
from twinct.pool.work import Died, Event, Work
from twinct.threads import available_threads

ANSWER_S = 10.0
"""In which a cluster has to answer."""

ASK_S = 300.0
"""In which each node has to answer: on a busy one a process needs a minute to start."""

LOOK_S = 2.0
"""How often a pool that waits makes sure that Ray is there."""


_SETTINGS = b"\4"
_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0" + _SETTINGS + b"\0\0\0\0\0"
"""How HTTP/2 begins, from either side a frame of settings (RFC 9113, 3.4 and 6.5)."""


@dataclass(frozen=True)
class _Come:
    """A parcel that is in Ray's store on this machine, whatever comes of the node that made it."""

    content: Bytes
    pool: RayPool

    def save(self, path: Path) -> None:
        """Unpack it there.

        Raises:
            StorageError: it cannot be written.
            ValueError: the pool is closed, and Ray's store with it.
        """
        if self.pool.closed:
            raise ValueError(f"{path}: the pool is closed")
        with arriving(path) as draft:
            unpack(self.content, draft)


class RayPool:
    """Processes on all nodes of a Ray cluster; see ``twinct.pool.Pool``.

    One thread at a time may use it, and one pool a process. Each piece of work is a task of Ray: it
    starts where processors and memory are free, in a process that works for nobody else meanwhile,
    and stays warm for the next. Parcels can be saved until it is closed.

    Attributes:
        closed: whether it is.
    """

    def __init__(
        self,
        address: str | None,
        *,
        name: str,
        threads: int = 1,
        workers: int | None = None,
        memory_bytes: int | None = None,
    ) -> None:
        """Connect; every node is asked for its versions.

        Args:
            address: None or ``local`` starts Ray on this machine and ends it with the pool;
                ``auto`` or HOST:PORT joins a cluster.
            name: of the pool's folder on each node, ``$TWINCT_CACHE`` (or a folder for temporary
                files) / name / host.
            threads: of a piece of work.
            workers: processes at a time, for a Ray of this machine; None for what threads allow.
            memory_bytes: for a Ray of this machine; None for what this process may take now.

        Raises:
            MissingExtraError: Ray is not installed.
            InputError: no Ray answers at the address, or a node has another twinct, Ray or Python.
            LinkError: Ray did not start.
        """
        require("cluster")
        local = address in (None, "local")
        told = {"threads": threads, "workers": workers, "memory_bytes": memory_bytes}
        problems = [
            f"{k}={v}: at least 1 needed" for k, v in told.items() if v is not None and v < 1
        ]
        if not local and (workers or memory_bytes):
            problems.append(
                f"{address}: a cluster has the processors and memory that its nodes say"
            )
        if Path(name).name != name:
            problems.append(f"{name!r}: cannot be the name of a folder")
        if problems:
            raise InputError(problems)
        os.environ.update(ENVIRONMENT | CLIENT)
        ray = node.ray_module()
        if ray.is_initialized():
            raise InputError("this process is connected to Ray already: one pool at a time")
        self._ray = ray
        self._threads = threads
        self._head: LocalRay | None = None
        self.closed = False
        self._paths: dict[str, Path] = {}
        self._tickets: dict[str, node.Ticket] = {}
        self._running: dict[Any, tuple[str, Any]] = {}
        self._size = (-1.0, 1, 0)
        try:
            if local:
                most = available_bytes()[0] if memory_bytes is None else memory_bytes
                processors = available_threads() if workers is None else workers * threads
                self._head = LocalRay(max(processors, threads), int(min(most, 2**62)))
                address = self._head.address
            self._address = _connect(address or "", local)
            lifeline = self._head.lifeline if self._head is not None else None
            self._terms = node.Terms(name, threads, node.versions(), lifeline)
            self._work: Any = ray.remote(
                num_cpus=threads, max_retries=0, num_returns=2, scheduling_strategy="SPREAD"
            )(node.work)
            self._compare()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def slots(self) -> int:
        """Of all nodes that live; at least one, since another may come."""
        return self._measured()[1]

    @property
    def most_memory_bytes(self) -> int:
        """Of the largest node that was ever seen."""
        return self._measured()[2]

    def offer(self, name: str, path: Path) -> None:
        """It travels when work first names it, once to each node."""
        self.withdraw(name)
        self._paths[name] = Path(path).absolute()

    def withdraw(self, name: str) -> None:
        """Work that was submitted before keeps it."""
        self._paths.pop(name, None)
        self._tickets.pop(name, None)

    def submit(self, work: Work) -> None:
        """See ``twinct.pool.Pool``."""
        request = sent(work)
        if work.memory_bytes > (most := self.most_memory_bytes):
            raise MemoryShortageError(
                f"work {work.key!r} takes {work.memory_bytes / 2**30:.2f} GiB of memory, and no "
                f"node has more than {most / 2**30:.2f} GiB"
            )
        if self.closed or any(work.key == key for key, _ in self._running.values()):
            raise ValueError("the pool is closed" if self.closed else f"{work.key!r}: known")
        if missing := [name for name in work.inputs if name not in self._paths]:
            raise ValueError(f"not offered to the pool: {', '.join(missing)}")
        with self._speaking():
            tickets = {name: self._ticket(name) for name in work.inputs}
            task = self._work.options(memory=work.memory_bytes or None, name="twinct")
            outcome, content = task.remote(request, tickets, self._terms)
        self._running[outcome] = (work.key, content)

    def wait(self, timeout_s: float | None = None) -> list[Event]:
        """See ``twinct.pool.Pool``.

        Raises:
            InputError: a node with another twinct, Ray or Python has come.
            LinkError: the whole cluster is gone.
        """
        until = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        while self._running:
            left = max(until - time.monotonic(), 0.0)
            with self._speaking():
                references = list(self._running)
                ready, _ = self._ray.wait(references, timeout=min(left, LOOK_S))
                if ready:  # and whatever else is
                    ready, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
                    return [self._event(reference) for reference in ready]
            if left <= LOOK_S:
                break
            self._look()
        return []

    def close(self, *, clear: bool = False) -> None:
        """See ``twinct.pool.Pool``; a Ray that was started for the pool ends with it."""
        if self.closed:
            return
        self.closed = True
        with contextlib.suppress(Exception):
            self._look()
            for reference in self._running:
                self._ray.cancel(reference, force=True)
            if clear:
                self._each_node(node.clear, self._terms.pool)
        self._running.clear()
        self._tickets.clear()
        try:
            self._ray.shutdown()
        finally:
            if self._head is not None:
                self._head.close()

    def _measured(self) -> tuple[float, int, int]:
        if time.monotonic() - self._size[0] > LOOK_S:
            self._look()
            with self._speaking():
                nodes = [n["Resources"] for n in self._ray.nodes() if n["Alive"]]
            slots = [int(n.get("CPU", 0) // self._threads) for n in nodes]
            most = [int(n.get("memory", 0)) for n, s in zip(nodes, slots, strict=True) if s]
            self._size = (time.monotonic(), max(sum(slots), 1), max([self._size[2], *most]))
        return self._size

    def _ticket(self, name: str) -> node.Ticket:
        if name not in self._tickets:
            path = self._paths[name]
            content = pack(path)
            digest = hashlib.sha256(content.data).hexdigest()[:32]
            self._tickets[name] = node.Ticket(digest, path.name, [self._ray.put(content)])
        return self._tickets[name]

    def _event(self, reference: Any) -> Event:
        key, content = self._running.pop(reference)
        failures = self._ray.exceptions
        try:
            outcome: Outcome = self._ray.get(reference)
            packed: dict[str, Bytes] = self._ray.get(content) if outcome.parcels else {}
        except failures.RayTaskError as error:
            raise getattr(error, "cause", error) from None
        except (failures.WorkerCrashedError, failures.OutOfMemoryError) as error:
            memory = isinstance(error, failures.OutOfMemoryError)
            return Died(key, "its node ran out of memory" if memory else "its worker was ended")
        except (failures.NodeDiedError, failures.ObjectLostError):
            return Died(key, "its node was lost", blamed=False)
        except (failures.RaySystemError, failures.LocalRayletDiedError, failures.RpcError):
            raise
        except failures.RayError as error:  # full disk, full store: not without end
            return Died(key, f"Ray gave it up: {_line(error)}")
        return event(key, outcome, {name: _Come(one, self) for name, one in packed.items()})

    def _compare(self) -> None:
        """Refuse nodes with other versions."""
        problems: list[str] = []
        for found in self._each_node(node.look):
            if isinstance(found, Exception):
                problems.append(f"a node is refused: it cannot be asked ({_line(found)})")
            elif found[1] != self._terms.versions:
                problems.append(
                    f"node {found[0]} is refused: it has {found[1]}; needed: {self._terms.versions}"
                )
        if problems:
            raise InputError(problems)

    def _each_node(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """What each node answers, or its error; nodes that are gone are left out."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        task = self._ray.remote(num_cpus=0, max_retries=0)(function)
        with self._speaking():
            asked = [
                task.options(
                    scheduling_strategy=NodeAffinitySchedulingStrategy(n["NodeID"], soft=False)
                ).remote(*arguments)
                for n in self._ray.nodes()
                if n["Alive"]
            ]
        failures = self._ray.exceptions
        found: list[Any] = []
        for reference in asked:
            try:
                found.append(self._ray.get(reference, timeout=ASK_S))
            except (failures.TaskUnschedulableError, failures.NodeDiedError):
                continue  # Ray counts a node that is gone for some seconds more
            except failures.RayError as error:
                found.append(error)
        return found

    def _look(self) -> None:
        """Make sure that Ray is there: its own patience is a minute, and it ends the process."""
        if not _answers(self._address) or (self._head is not None and not self._head.alive):
            raise LinkError(f"Ray at {self._address} does not answer any more: the cluster is gone")

    @contextlib.contextmanager
    def _speaking(self) -> Iterator[None]:
        """Tell in one message that Ray is gone."""
        try:
            yield
        except (
            self._ray.exceptions.RaySystemError,
            self._ray.exceptions.LocalRayletDiedError,
            self._ray.exceptions.RpcError,
            ConnectionError,
        ) as error:
            raise LinkError(f"Ray at {self._address} does not answer: {_line(error)}") from error


def _connect(address: str, local: bool) -> str:
    """Join a cluster; its address."""
    if address != "auto" and not _answers(address, as_ray=True):
        raise InputError(f"{address}: no Ray answers there (HOST:PORT, auto or local needed)")
    ray = node.ray_module()
    from ray._private import ray_constants, worker

    # Ray has read its environment when it was imported.
    ray._raylet.Config.initialize("")
    ray._raylet.AuthenticationTokenLoader.instance().reset_cache()
    # A local Ray listens on loopback alone, where Ray's clients do not look else.
    ray_constants.ENABLE_RAY_CLUSTER = not local
    # Of deaths our events tell; Ray's messages would come between.
    worker.print_to_stdstream = lambda *_, **__: None
    handler = signal.getsignal(signal.SIGTERM)
    try:
        with _quiet():
            context = ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
    except (ray.exceptions.RayError, ConnectionError, RuntimeError, ValueError) as error:
        problem = f"{address}: no Ray answers there that we can use: {_line(error)}"
        raise InputError(problem) from error
    finally:
        signal.signal(signal.SIGTERM, handler)  # Ray puts its own there
    return context.address_info["gcs_address"]


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep away from the terminal what Ray's C++ part writes to it."""
    sys.stderr.flush()
    kept = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _answers(address: str, *, as_ray: bool = False) -> bool:
    """Whether something listens there, and speaks as Ray does: gRPC, over HTTP/2."""
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), ANSWER_S) as connection:
            if as_ray:
                connection.sendall(_HELLO)
                return connection.recv(9)[3:4] == _SETTINGS
            return True
    except (OSError, ValueError):
        return False


def _line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
