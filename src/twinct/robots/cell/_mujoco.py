"""MuJoCo, imported on first use."""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any

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


class _OnFirstUse(ModuleType):
    """Module that is imported when one of its names is used, and keeps the names in use."""

    def __getattr__(self, name: str) -> Any:
        value = getattr(mujoco_module(), name)
        setattr(self, name, value)
        return value


if TYPE_CHECKING:
    import mujoco
else:
    mujoco = _OnFirstUse("mujoco")
