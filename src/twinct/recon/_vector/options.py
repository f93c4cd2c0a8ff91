"""Compiler options and argument types of the kernels."""

from __future__ import annotations

from typing import Any

from numba import njit

OPTIONS: dict[str, Any] = {"fastmath": True, "nogil": True, "error_model": "numpy"}
"""Options of all functions in the kernels."""

IMAGE, CUBE, RAYS, MATRIX = "f4[:, ::1]", "f4[:, :, ::1]", "f8[:, ::1]", "f8[:, ::1]"
STACK, MATRICES = "f4[:, :, ::1]", "f8[:, :, ::1]"
"""Types of the kernels' arguments."""


def kernel(signature: str, parallel: bool = True) -> Any:
    """Return a decorator that compiles for one signature at import, or loads from disk."""
    return njit(f"void{signature}", cache=True, parallel=parallel, **OPTIONS)
