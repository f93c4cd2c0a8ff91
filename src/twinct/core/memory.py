"""Memory that this process may still allocate, and the cause of the limit."""

from __future__ import annotations

import math
import re
import resource
from collections.abc import Iterator
from pathlib import Path

from twinct.core.errors import MemoryShortageError

_MEMINFO = Path("/proc/meminfo")
_STATUS = Path("/proc/self/status")
_CGROUPS = Path("/sys/fs/cgroup")
_ULIMIT = "limit of this process (ulimit)"
_SQUARE = 256
"""Size of matrices whose product takes BLAS's buffers."""


_NO_MEMORY = (
    *("failed to map segment", "cannot allocate memory", "could not allocate memory"),
    *("can't start new thread", "bad_alloc"),
    *("without exception set", "without setting an exception"),
)
"""Words of libraries, the dynamic loader and Python about a lack of memory, in small letters.

The last two are those of a function in C that failed and found no memory for an exception.
"""


def lacks_memory(error: BaseException) -> bool:
    """Return True if an exception, or one behind it, shows that memory was lacking."""
    seen: BaseException | None = error
    while seen is not None:
        words = str(seen).lower()
        if isinstance(seen, MemoryError) or any(word in words for word in _NO_MEMORY):
            return True
        seen = seen.__cause__ or seen.__context__
    return False


SHORTAGE = "too little memory"
"""Beginning of messages about it, by which a scan knows why one of its nodes ended."""

LITTLE_BYTES = 2**30
"""Memory below which a library may fail to load its drivers, without saying why."""


def if_little() -> str:
    """Return a clause about the memory that is left, if it is little; else nothing."""
    available, limit = available_bytes()
    if available >= LITTLE_BYTES:
        return ""
    return f"; only {available / 2**30:.2f} GiB of memory are left, by the {limit}"


LEAST_BYTES = 512 * 2**20
"""Memory below which no command that computes has room for its libraries."""


def load_blas_if_limited() -> None:
    """Load BLAS while there is room, if a limit of this process may end its memory.

    OpenBLAS tries to allocate its buffers without end, in C code that hears no Ctrl-C.

    Raises:
        MemoryShortageError: the limit leaves less than ``LEAST_BYTES``.
    """
    if not require_of_ulimit(LEAST_BYTES):
        return
    import numpy as np
    from scipy.linalg import blas

    square = np.ones((_SQUARE, _SQUARE))
    _ = square @ square, blas.dgemm(1.0, square, square)  # each library has buffers of its own


def require_of_ulimit(least_bytes: int, needed_by: str = "") -> bool:
    """Return True if a limit of this process leaves so much memory, False if there is no limit.

    Raises:
        MemoryShortageError: it leaves less, and C code would end the process without a message.
    """
    limits = [left for left, cause in _limits() if cause == _ULIMIT]
    if limits and min(limits) < least_bytes:
        raise MemoryShortageError(
            f"{SHORTAGE}: {min(limits) / 2**20:.0f} MiB are left by the {_ULIMIT}; at least "
            f"{least_bytes / 2**20:.0f} MiB are needed{needed_by}"
        )
    return bool(limits)


def available_bytes() -> tuple[float, str]:
    """Return the bytes that this process may still allocate, or infinity, and the limit's cause."""
    return min(_limits(), default=(math.inf, "unknown"))


def _limits() -> Iterator[tuple[float, str]]:
    free = _kilobytes(_MEMINFO, "MemAvailable")
    if free is not None:
        yield free, "free memory of the machine"
    for kind, name in ((resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData")):
        soft, _ = resource.getrlimit(kind)
        used = _kilobytes(_STATUS, name)
        if soft != resource.RLIM_INFINITY and used is not None:
            yield max(soft - used, 0), _ULIMIT
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
    """Return the first number that begins a line of a file, after ``name`` if given."""
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError):
        return None
    match = re.search(rf"^{re.escape(name)}\s*(\d+)\b", text, re.MULTILINE)
    return int(match[1]) if match else None
