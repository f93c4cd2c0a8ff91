"""Pool of processes on the machines of a Ray cluster."""

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
from dataclasses import replace
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, LinkError
from twinct.core.extras import require
from twinct.core.memory import available_bytes
from twinct.core.threads import available_threads
from twinct.workers.artifact import arriving
from twinct.workers.call import received
from twinct.workers.cluster import node
from twinct.workers.cluster.content import Bytes, pack, unpack
from twinct.workers.cluster.local import LocalRay, set_environment, start
from twinct.workers.pool import Pool
from twinct.workers.work import Died, Done, Event, Failed, Work

ANSWER_S = 10.0
"""Timeout for a connection to a cluster."""

ASK_S = 300.0
"""Timeout for an answer of each node: on a busy node, a process needs a minute to start."""

LOOK_S = 2.0
"""Interval at which a waiting pool checks that Ray still answers."""


def _require_valid(cluster: str | None, name: str, numbers: dict[str, int | None]) -> None:
    problems = [
        f"{k}={v}: must be at least 1" for k, v in numbers.items() if v is not None and v < 1
    ]
    if cluster is not None and (numbers["workers"] or numbers["memory_bytes"]):
        problems.append(f"{cluster}: the nodes of a cluster set its processors and memory")
    if Path(name).name != name:
        problems.append(f"{name!r} is not a valid folder name")
    if cluster not in (None, "auto") and not _answers(cluster or ""):
        problems.append(f"{cluster}: no Ray answers there; give HOST:PORT, auto or local")
    if problems:
        raise InputError(problems)


class RayPool(Pool):
    """Processes on all nodes of a Ray cluster; see ``twinct.workers.Pool``.

    A process may have only one pool of this kind. Each piece of work is a task of Ray: it starts
    on a node with free processors and memory, in a process of its own, which stays warm for the
    next piece. An offer is sent when work first needs it, once to each node. What work attached
    lies in Ray's store on this machine, independent of its node, until the pool is closed.
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
        """Connect to Ray, and check the versions of every node.

        Args:
            address: None or ``local`` starts Ray on this machine and ends it with the pool;
                ``auto`` or HOST:PORT joins a cluster.
            name: name of the pool's folder on each node, ``$TWINCT_CACHE`` (or a folder for
                temporary files) / name / host.
            threads: threads of a piece of work.
            workers: number of concurrent processes, for a local Ray; None: as many as the threads
                of this machine allow.
            memory_bytes: memory limit of a local Ray; None: the memory available now.

        Raises:
            MissingExtraError: Ray is not installed.
            InputError: no Ray answers at the address, a node has another version of twinct, Ray
                or Python, or Ray was imported before without what a local Ray needs.
            LinkError: Ray did not start.
        """
        require("cluster")
        local = address in (None, "local")
        own = {"workers": workers, "memory_bytes": memory_bytes}
        _require_valid(None if local else address, name, {"threads": threads, **own})
        set_environment(local=local)
        ray = node.ray_module()
        if ray.is_initialized():
            raise InputError("this process is already connected to Ray: use one pool at a time")
        self._ray = ray
        failures = ray.exceptions
        self._lost = failures.RaySystemError, failures.LocalRayletDiedError, failures.RpcError
        self._threads = threads
        self._head: LocalRay | None = None
        super().__init__()
        self._tickets: dict[str, node.Ticket] = {}
        self._running: dict[Any, tuple[str, Any]] = {}
        self._size = (-1.0, 1, 0)
        try:
            if local:
                most = available_bytes()[0] if memory_bytes is None else memory_bytes
                processors = available_threads() if workers is None else workers * threads
                self._head = start(max(processors, threads), int(min(most, 2**62)))
                address = self._head.address
            self._address = _connect(address or "")
            lifeline = self._head.lifeline if self._head is not None else None
            self._terms = node.Terms(name, threads, node.versions(), lifeline)
            self._work: Any = ray.remote(
                num_cpus=threads, max_retries=0, num_returns=2, scheduling_strategy="SPREAD"
            )(node.work)
            self._compare()
        except BaseException:
            self.close()
            raise

    @property
    def slots(self) -> int:
        """Slots of all live nodes; at least 1, as further nodes may join."""
        return self._measured()[1]

    @property
    def most_memory_bytes(self) -> int:
        """Memory of the largest node since the pool was created."""
        return self._measured()[2]

    def withdraw(self, name: str) -> None:
        """Withdraw an offer; work that was submitted before can still use it."""
        super().withdraw(name)
        self._tickets.pop(name, None)

    def save(self, done: Done, name: str, path: Path) -> None:
        """Unpack a file or folder that work attached to a path; see ``twinct.workers.Pool``.

        Raises:
            StorageError: the path cannot be written.
            ValueError: the pool is closed, and Ray's store with it.
        """
        if self.closed:
            raise ValueError(f"{path}: the pool is closed")
        with arriving(path) as draft:
            unpack(done.artifacts[name], draft)

    def _start(self, work: Work, request: bytes) -> None:
        with self._speaking():
            tickets = {name: self._ticket(name) for name in work.inputs}
            task = self._work.options(memory=work.memory_bytes or None, name="twinct")
            event, content = task.remote(request, tickets, self._terms)
        self._running[event] = (work.key, content)

    def _events(self, timeout_s: float | None) -> list[Event]:
        until = float("inf") if timeout_s is None else time.monotonic() + timeout_s
        while self._running:
            left = max(until - time.monotonic(), 0.0)
            with self._speaking():
                references = list(self._running)
                ready, _ = self._ray.wait(references, timeout=min(left, LOOK_S))
                if ready:  # fetch all finished tasks at once
                    ready, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
                    return [self._event(reference) for reference in ready]
            if left <= LOOK_S:
                break
            self._look()
        return []

    def close(self, *, clear: bool = False) -> None:
        """Close the pool and the Ray that it started; see ``twinct.workers.Pool``."""
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
        self._keys.clear()
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
            path = self._offers[name]
            content = pack(path)
            digest = hashlib.sha256(content.data).hexdigest()[:32]
            self._tickets[name] = node.Ticket(digest, path.name, [self._ray.put(content)])
        return self._tickets[name]

    def _event(self, reference: Any) -> Event:
        key, content = self._running.pop(reference)
        self._keys.discard(key)  # also if the whole pool fails
        failures = self._ray.exceptions
        try:
            event: Done | Failed = self._ray.get(reference)
            packed: dict[str, Bytes] = self._ray.get(content)
        except failures.RayTaskError as error:
            raise getattr(error, "cause", error) from None
        except (failures.WorkerCrashedError, failures.OutOfMemoryError) as error:
            memory = isinstance(error, failures.OutOfMemoryError)
            return Died(key, "its node ran out of memory" if memory else "its worker was killed")
        except (failures.NodeDiedError, failures.ObjectLostError):
            return Died(key, "its node was lost", blamed=False)
        except self._lost:
            raise
        except failures.RayError as error:  # full disk or store: limit the retries
            return Died(key, f"Ray gave up on it: {_line(error)}")
        event = received(event)
        return event if isinstance(event, Failed) else replace(event, artifacts=packed)

    def _compare(self) -> None:
        """Raise if a node has other versions."""
        problems: list[str] = []
        for other in self._each_node(node.look):
            if isinstance(other, Exception):
                problems.append(f"a node is refused: it does not answer ({_line(other)})")
            elif other[1] != self._terms.versions:
                problems.append(
                    f"node {other[0]} is refused: it has {other[1]}; needed: {self._terms.versions}"
                )
        if problems:
            raise InputError(problems)

    def _each_node(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Call a function on each node; return its results or errors, without lost nodes."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        task = self._ray.remote(num_cpus=0, max_retries=0)(function)
        with self._speaking():
            references = [
                task.options(
                    scheduling_strategy=NodeAffinitySchedulingStrategy(n["NodeID"], soft=False)
                ).remote(*arguments)
                for n in self._ray.nodes()
                if n["Alive"]
            ]
        failures = self._ray.exceptions
        results: list[Any] = []
        for reference in references:
            try:
                results.append(self._ray.get(reference, timeout=ASK_S))
            except (failures.TaskUnschedulableError, failures.NodeDiedError):
                continue  # Ray lists a lost node for some more seconds
            except failures.RayError as error:
                results.append(error)
        return results

    def _look(self) -> None:
        """Raise if Ray does not answer; Ray itself waits a minute, and then ends the process."""
        if not _answers(self._address):
            raise LinkError(f"Ray at {self._address} does not answer: the cluster is gone")

    @contextlib.contextmanager
    def _speaking(self) -> Iterator[None]:
        """Turn all errors of a lost connection into one ``LinkError``."""
        try:
            yield
        except (*self._lost, ConnectionError) as error:
            raise LinkError(f"Ray at {self._address} does not answer: {_line(error)}") from error


def _connect(address: str) -> str:
    """Join a cluster and return its address."""
    ray = node.ray_module()
    handler = signal.getsignal(signal.SIGTERM)
    try:
        with _quiet(), _in_own_folder():
            context = ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
    except (ray.exceptions.RayError, ConnectionError, RuntimeError, ValueError) as error:
        problem = f"{address}: cannot connect to the Ray there: {_line(error)}"
        raise InputError(problem) from error
    finally:
        signal.signal(signal.SIGTERM, handler)  # Ray installs its own handler
    return context.address_info["gcs_address"]


@contextlib.contextmanager
def _in_own_folder() -> Iterator[None]:
    """Go to the first folder from which this process imports modules, such as its script's.

    Ray lets its workers import modules from the current folder, which may be a stranger's.
    """
    first = next((path for path in sys.path if not path or os.path.isdir(path)), "")
    with contextlib.chdir(first or "."):
        yield


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the terminal output of Ray's C++ part during a block."""
    sys.stderr.flush()
    stderr = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


def _answers(address: str) -> bool:
    """Return True if a server listens there."""
    host, _, port = address.rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), ANSWER_S):
            return True
    except (OSError, ValueError, OverflowError):  # the last for a port beyond 65,535
        return False


def _line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
