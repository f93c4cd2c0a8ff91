"""Number of threads that this process and its children may use, in all libraries."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted, whole_number

SETTING = "TWINCT_THREADS"
_CPU_MAX = Path("/sys/fs/cgroup/cpu.max")

_ENVIRONMENT = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"),
    "NUMBA_NUM_THREADS",
    *("BLOSC_NTHREADS", "ZARR_THREADING__MAX_WORKERS"),
    "LP_NUM_THREADS",
)
"""Variables that BLAS, numba, Blosc, Zarr and Mesa's software renderer read when they start."""


_WAITING = "OMP_WAIT_POLICY"


def let_idle_threads_sleep() -> None:
    """Let OpenMP's threads sleep while they wait, unless the environment says otherwise.

    By default they spin for some milliseconds after each kernel, which takes a processor from other
    processes. This has an effect before the first kernel runs in parallel.
    """
    os.environ.setdefault(_WAITING, "passive")


def available_threads() -> int:
    """Return the number of processors for this process, limited by the quota of its container."""
    processors = len(os.sched_getaffinity(0))
    try:
        quota, period = _CPU_MAX.read_text(encoding="ascii").split()
        return max(min(processors, math.ceil(int(quota) / int(period))), 1)
    except (OSError, ValueError):  # no such file, or "max"
        return processors


def threads() -> int:
    """Return the limit in force: ``TWINCT_THREADS``, or the number of available threads.

    Raises:
        InputError: the variable is not a whole number of at least 1.
    """
    text = os.environ.get(SETTING, "").strip()
    if not text:
        return available_threads()
    number = whole_number(text)
    if not number:
        raise InputError(f"{SETTING}={quoted(text)}: must be a whole number of at least 1")
    return number


def load_numba() -> None:
    """Load numba with as many threads as it may have: what ``limit_threads`` says can change.

    A bound that numba finds when it is loaded is for good; a larger one later has no effect.
    """
    import numba  # noqa: F401


def limit_threads(number: int | None = None) -> int:
    """Limit the threads of all libraries, here and in children; return the limit.

    This covers numba, BLAS, Blosc and the renderer. They read their variables when they are loaded:
    call this first. Libraries that are already loaded get the limit through their own functions,
    where they have one. gVXR's renderer keeps the value that it read when it started.

    Args:
        number: threads; None for ``TWINCT_THREADS``, or the number of available threads. Without
            either, variables of single libraries keep their values.

    Raises:
        InputError: not a whole number of at least 1.
    """
    if number is not None:
        if number < 1:
            raise InputError(f"threads {number}: must be at least 1")
        os.environ[SETTING] = str(number)
    set_by_user = bool(os.environ.get(SETTING, "").strip())
    bound = threads()
    loaded = "numba" in sys.modules
    let_idle_threads_sleep()
    for name in _ENVIRONMENT:
        # numba reads it again, and refuses another number once its threads run.
        if not (loaded and name == "NUMBA_NUM_THREADS"):
            os.environ[name] = str(bound) if set_by_user else os.environ.get(name, str(bound))
    if not set_by_user:
        return bound
    if loaded:
        import numba
        from numba.core import config

        most: int = vars(config)["NUMBA_NUM_THREADS"]
        numba.set_num_threads(min(bound, most))
    if "numpy" in sys.modules:
        from threadpoolctl import threadpool_limits

        threadpool_limits(bound)
    return bound
