"""Functions that run on a node: one piece of work, report of versions, removal of folders."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import socket
import stat
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.writing import complete
from twinct.core.threads import limit_threads
from twinct.version import __version__
from twinct.workers.call import call
from twinct.workers.cluster.content import Bytes, pack, unpack
from twinct.workers.lifeline import end_with
from twinct.workers.work import Done, Failed, Place


def ray_module() -> Any:
    """Import Ray; this takes seconds, and Ray reads its environment at import."""
    import ray

    return ray


@dataclass(frozen=True)
class Ticket:
    """Content to be fetched; a list around its reference keeps Ray from resolving it."""

    digest: str
    name: str
    references: list[Any]


@dataclass(frozen=True)
class Terms:
    """Settings of a pool for each of its worker processes.

    Attributes:
        pool: name of its folders on the nodes.
        threads: threads of a piece of work.
        versions: versions that the process must have.
        lifeline: a named pipe that the pool's process holds, if it is on this machine.
    """

    pool: str
    threads: int
    versions: str
    lifeline: Path | None


def _unpacked(ticket: Ticket, folder: Path) -> Path:
    """Return the path of an offer; unpack it unless another worker has already done so."""
    path = folder / "inputs" / ticket.digest / ticket.name
    if path.exists():
        return path
    content = ray_module().get(ticket.references[0])
    path.parent.parent.mkdir(parents=True, exist_ok=True)
    try:
        with complete(path.parent) as draft:
            draft.mkdir()
            unpack(content, draft / ticket.name)
    except OSError:
        if not path.exists():  # otherwise another worker was faster
            raise
    return path


@cache
def versions() -> str:
    """Return the versions that must agree on all nodes, with a digest of twinct's sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return (
        f"twinct {__version__} ({digest.hexdigest()[:8]}), "
        f"Ray {ray_module().__version__}, Python {platform.python_version()}"
    )


def folder(pool: str) -> Path:
    """Return the folder of a pool on this machine; it does not change when Ray restarts.

    Raises:
        InputError: others may write to the folder for temporary files of this user.
    """
    given = os.environ.get("TWINCT_CACHE")
    parent = Path(given).absolute() if given else _own_folder()
    return parent / pool / socket.gethostname()


def _own_folder() -> Path:
    """Return this user's folder among the temporary files, whose name others can guess."""
    path = Path(tempfile.gettempdir()).absolute() / f"twinct-studies-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    status = path.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise InputError(
            f"{path}: another user may write there; remove it, or set TWINCT_CACHE to a folder of "
            "your own"
        )
    return path


@cache
def _prepare(terms: Terms) -> None:
    """Set up a process before its first work."""
    if terms.lifeline is not None:
        # Ray ends its processes, too, but late, and not while an engine is at work.
        end_with(os.open(terms.lifeline, os.O_RDONLY | os.O_NONBLOCK))
    if versions() != terms.versions:
        raise InputError(
            f"node {socket.gethostname()} is refused: it has {versions()}; needed: {terms.versions}"
        )
    limit_threads(terms.threads)


def work(
    request: bytes, tickets: dict[str, Ticket], terms: Terms
) -> tuple[Done | Failed, dict[str, Bytes]]:
    """Execute a request; return its event without artifacts, and their content."""
    _prepare(terms)
    here = folder(terms.pool)
    here.mkdir(parents=True, exist_ok=True)
    event = call(request, Place(here, terms.threads, lambda name: _unpacked(tickets[name], here)))
    if isinstance(event, Failed):
        return event, {}
    try:
        content = {name: pack(path) for name, path in event.artifacts.items()}
    except OSError as error:
        problem = f"the result cannot be read: {error}"
        return Failed(event.key, type(error).__name__, (problem,), "", event.seconds), {}
    return replace(event, artifacts={}), content


def look() -> tuple[str, str]:
    """Return name and versions of this node."""
    return socket.gethostname(), versions()


def clear(pool: str) -> None:
    """Remove the folder of a pool on this node."""
    shutil.rmtree(folder(pool), ignore_errors=True)
