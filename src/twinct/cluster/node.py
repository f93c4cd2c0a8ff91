"""What is done on a node: one piece of work, a look at its versions, clearing up."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import socket
import tempfile
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from twinct.cluster.content import Bytes, pack, unpack
from twinct.errors import InputError
from twinct.pool.call import Outcome, call
from twinct.pool.lifeline import end_with
from twinct.pool.parcel import remove
from twinct.threads import limit_threads
from twinct.version import __version__


def ray_module() -> Any:
    """Ray: it takes seconds, and reads its environment when it is imported."""
    import ray

    return ray


@dataclass(frozen=True)
class Ticket:
    """Content that may be fetched: Ray's reference in a list, so that Ray leaves it alone."""

    digest: str
    name: str
    references: list[Any]


@dataclass(frozen=True)
class Terms:
    """What a pool tells each process that works for it.

    Attributes:
        pool: name of its folders on the nodes.
        threads: of a piece of work.
        versions: that the process must have.
        lifeline: a named pipe that the pool's process holds, if it is on this machine.
    """

    pool: str
    threads: int
    versions: str
    lifeline: Path | None


@dataclass(frozen=True)
class NodePlace:
    """A folder of a node; what was offered is unpacked there, once."""

    folder: Path
    threads: int
    tickets: Mapping[str, Ticket]

    def fetch(self, name: str) -> Path:
        """Unpack it unless another worker of the node has."""
        ticket = self.tickets[name]
        path = self.folder / "inputs" / ticket.digest / ticket.name
        if path.exists():
            return path
        content = ray_module().get(ticket.references[0])
        draft = path.parent.with_name(f".{uuid.uuid4().hex}")
        try:
            draft.mkdir(parents=True)
            unpack(content, draft / ticket.name)
            draft.rename(path.parent)
        except OSError:
            if not path.exists():  # else another worker was faster
                raise
        finally:
            remove(draft)
        return path


@cache
def versions() -> str:
    """Of what has to be the same everywhere; twinct's also by its sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return (
        f"twinct {__version__} ({digest.hexdigest()[:8]}), "
        f"Ray {ray_module().__version__}, Python {platform.python_version()}"
    )


def folder(pool: str) -> Path:
    """That a pool has on this machine; the same after a new start of Ray."""
    parent = os.environ.get("TWINCT_CACHE") or str(
        Path(tempfile.gettempdir()) / f"twinct-studies-{os.getuid()}"
    )
    return Path(parent).absolute() / pool / socket.gethostname()


@cache
def _prepare(terms: Terms) -> None:
    """Once a process, before its first work."""
    if terms.lifeline is not None:
        # Ray ends its processes, too, in its own time and not while an engine is at work.
        end_with(os.open(terms.lifeline, os.O_RDONLY | os.O_NONBLOCK))
    if versions() != terms.versions:
        raise InputError(
            f"node {socket.gethostname()} is refused: it has {versions()}; needed: {terms.versions}"
        )
    limit_threads(terms.threads)


def work(
    request: bytes, tickets: dict[str, Ticket], terms: Terms
) -> tuple[Outcome, dict[str, Bytes]]:
    """What came of it, and the content of its parcels."""
    _prepare(terms)
    place = NodePlace(folder(terms.pool), terms.threads, tickets)
    place.folder.mkdir(parents=True, exist_ok=True)
    outcome = call(request, place)
    try:
        return outcome, {name: pack(path) for name, path in outcome.parcels.items()}
    except OSError as error:
        problem = f"what was made cannot be read: {error}"
        return Outcome(failure=(type(error).__name__, (problem,), ""), seconds=outcome.seconds), {}


def look() -> tuple[str, str]:
    """Name and versions of this node."""
    return socket.gethostname(), versions()


def clear(pool: str) -> None:
    """Remove the folder of a pool."""
    shutil.rmtree(folder(pool), ignore_errors=True)
