"""How kernels are compiled."""

from __future__ import annotations

from typing import Any

from numba import njit

OPTIONS: dict[str, Any] = {"fastmath": True, "nogil": True, "error_model": "numpy"}
"""For all functions that kernels are made of."""

IMAGE, CUBE, RAYS, MATRIX = "f4[:, ::1]", "f4[:, :, ::1]", "f8[:, ::1]", "f8[:, ::1]"
STACK, MATRICES = "f4[:, :, ::1]", "f8[:, :, ::1]"
"""Types of the arguments."""


def kernel(signature: str, parallel: bool = True) -> Any:
    """Compile for these arguments alone, at import, or take what was compiled from disk."""
    return njit(f"void{signature}", cache=True, parallel=parallel, **OPTIONS)
