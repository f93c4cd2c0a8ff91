"""The CUDA card: the device on which Warp's kernels run.

The environment variable ``TWINCT_CUDA_DEVICE`` selects the device, ``cuda:0`` by default. With
``cpu`` the kernels run on the processor, slowly: for tests, and to debug without a card.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from twinct.core.errors import InputError, MemoryShortageError
from twinct.core.extras import require
from twinct.core.foreign_text import quoted

DEVICE_VARIABLE = "TWINCT_CUDA_DEVICE"
DEFAULT_DEVICE = "cuda:0"


@cache
def warp() -> Any:
    """Return the module Warp, which then prints errors alone.

    Raises:
        MissingExtraError: it is not installed.
    """
    require("cuda")
    import warp as module

    module.config.log_level = module.LOG_ERROR
    with _silent():
        module.init()
    return module


@contextmanager
def _silent() -> Iterator[None]:
    """Drop what native code prints, such as Warp's note that there is no card."""
    sys.stderr.flush()
    stderr, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


def device() -> Any:
    """Return Warp's device that the environment selects.

    Raises:
        MissingExtraError: Warp is not installed.
        InputError: there is no card, or no device of this name.
    """
    name = os.environ.get(DEVICE_VARIABLE) or DEFAULT_DEVICE
    known = [str(one) for one in warp().get_devices()]
    if name in known:
        return warp().get_device(name)
    if name.startswith("cuda") and known == ["cpu"]:
        raise InputError(
            f"no CUDA card or driver is found here, so the device {quoted(name)} cannot be used: "
            "reconstruct on the processor (unset TWINCT_ENGINE), render with xray.engine=gvxr or "
            f"mesh; {DEVICE_VARIABLE}=cpu runs the card's kernels on the processor, slowly"
        )
    raise InputError(
        f"{DEVICE_VARIABLE} is {quoted(name)}; it must be cuda:N or cpu (here: {', '.join(known)})"
    )


def require_room(where: Any, needed: int) -> None:
    """Check that a card has so many bytes free. The processor's memory is checked elsewhere.

    Raises:
        MemoryShortageError: it has less.
    """
    if not where.is_cuda:
        return
    free = int(where.free_memory)
    if needed > free:
        raise MemoryShortageError(
            f"{needed / 1e9:.2f} GB of the card {where.name} are needed, and {free / 1e9:.2f} GB "
            "are free; use fewer voxels, or the engine vector"
        )
