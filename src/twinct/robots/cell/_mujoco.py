"""MuJoCo, imported on first use."""

from __future__ import annotations

from types import ModuleType

from twinct.core.errors import MissingExtraError


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
