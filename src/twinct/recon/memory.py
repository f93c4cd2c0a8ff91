"""What each algorithm needs in memory, against what this process may use."""

from __future__ import annotations

import math
import re
import resource
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twinct.errors import MemoryShortageError
from twinct.recon.algorithm import Algorithm
from twinct.recon.projector import Projector

SPARE_BYTES = 96 * 2**20
"""Images, threads, compiled code."""

_MEMINFO = Path("/proc/meminfo")
_STATUS = Path("/proc/self/status")
_CGROUPS = Path("/sys/fs/cgroup")


def peak_bytes(algorithm: Algorithm[Any], voxels: int, pixels: int) -> int:
    """Bytes that an algorithm takes beside what it is given; pixels of all views together."""
    return int(4 * (algorithm.volumes * voxels + algorithm.projections * pixels)) + SPARE_BYTES


def available_bytes() -> tuple[float, str]:
    """Bytes that this process may still take, and what sets the limit; infinite if unknown."""
    return min(_limits(), default=(math.inf, "unknown"))


def _limits() -> Iterator[tuple[float, str]]:
    free = _kilobytes(_MEMINFO, "MemAvailable")
    if free is not None:
        yield free, "free memory of the machine"
    for kind, name in ((resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData")):
        soft, _ = resource.getrlimit(kind)
        used = _kilobytes(_STATUS, name)
        if soft != resource.RLIM_INFINITY and used is not None:
            yield max(soft - used, 0), "limit of this process (ulimit)"
    for limit, usage, cache in (
        ("memory.max", "memory.current", "memory.stat"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "memory/memory.stat"),
    ):
        most, used = _number(_CGROUPS / limit), _number(_CGROUPS / usage)
        if most is not None and used is not None and most < 2**60:
            used -= _number(_CGROUPS / cache, "inactive_file") or 0
            yield max(most - used, 0), "limit of this container (cgroup)"


def _kilobytes(path: Path, name: str) -> int | None:
    number = _number(path, f"{name}:")
    return None if number is None else 1024 * number


def _number(path: Path, name: str = "") -> int | None:
    """The number that begins a line of a file, after a name if given."""
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return None
    found = re.search(rf"^{re.escape(name)}\s*(\d+)\b", text, re.MULTILINE)
    return int(found[1]) if found else None


def refuse_if_short(needed: int, what: str, advice: str) -> None:
    """Raise MemoryShortageError, with what is needed and there and what to change."""
    available, limit = available_bytes()
    if needed > available:
        raise MemoryShortageError(
            f"{what} needs {needed / 2**30:.2f} GiB of memory, and {available / 2**30:.2f} GiB are "
            f"available ({limit}): {advice}"
        )


def require_memory(algorithm: Algorithm[Any], A: Projector) -> None:
    """Refuse to start what cannot fit, beside what is in memory already."""
    voxels, pixels = math.prod(A.domain_shape), math.prod(A.range_shape)
    parts = f"{algorithm.volumes:g} x {voxels * 4 / 2**30:.2f} GiB of voxels"
    if algorithm.projections:
        parts += f" and {algorithm.projections:g} x {pixels * 4 / 2**30:.2f} GiB of pixels"
    refuse_if_short(
        peak_bytes(algorithm, voxels, pixels),
        f"{algorithm.name} with a grid of {A.domain_shape} voxels and {A.range_shape} pixels "
        f"({parts})",
        advice(algorithm),
    )


def advice(algorithm: Algorithm[Any] | None = None) -> str:
    """What to change where memory is short."""
    text = "use fewer or larger voxels, or fewer views or pixels"
    if algorithm is not None and (algorithm.volumes > 1 or algorithm.projections):
        text += ", or sart, which needs 1 volume"
    return text
