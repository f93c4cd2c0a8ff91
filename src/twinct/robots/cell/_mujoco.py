"""MuJoCo, imported on first use and with a rendering back end that needs no display."""

from __future__ import annotations

import os
import sys
from types import ModuleType

from twinct.core.errors import MissingExtraError

# MuJoCo reads MUJOCO_GL on its first import, so it must be set before; a user's value is kept.
# EGL can share a process with gVXR's context, GLFW cannot.
if sys.platform.startswith("linux") and not os.environ.get("MUJOCO_GL", "").strip():
    os.environ["MUJOCO_GL"] = "egl"  # empty counts as not set


def mujoco_module() -> ModuleType:
    """Return the module ``mujoco``.

    Raises:
        MissingExtraError: MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtraError("mujoco", "robots") from error
    return mujoco
