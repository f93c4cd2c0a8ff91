"""Simulation of twin robotic CT: two arms, X-ray projections, ROS 2, reconstruction, evaluation.

Public names are imported from their modules; the first ones that a notebook needs are here, too.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from twinct.core.system_libraries import egl_is_there
from twinct.version import __version__

if TYPE_CHECKING:
    from twinct.recon.volume import Volume
    from twinct.runs import compare, evaluate, load_scan, needs, reconstruct, run, simulate
    from twinct.scenario import load_scenario
    from twinct.study import load_results, run_study


__all__ = [
    "__version__",
    "Volume",
    "compare",
    "evaluate",
    "load_results",
    "load_scan",
    "load_scenario",
    "needs",
    "reconstruct",
    "run",
    "run_study",
    "simulate",
]

_HOMES = {name: "twinct.runs" for name in __all__[1:]} | {
    "Volume": "twinct.recon.volume",
    "load_results": "twinct.study",
    "run_study": "twinct.study",
    "load_scenario": "twinct.scenario",
}


def __getattr__(name: str) -> Any:
    """Import the entry points on first use, so that ``import twinct`` needs no engine."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'twinct' has no attribute {name!r}")


# Libraries read these variables when they are first imported; values of the user are kept.
# numba also reads its two from .numba_config.yaml in the working directory, which may be a
# stranger's: the first names a folder of compiled code, the second a class. Variables come first.
for _name in ("NUMBA_CACHE_DIR", "NUMBA_CACHE_LOCATOR_CLASSES"):
    os.environ.setdefault(_name, "")
# MuJoCo's other choice, GLFW, looks for code in the working directory, needs a display, and cannot
# share a process with gVXR's context. Without EGL, MuJoCo 4 cannot even be imported unless it is
# told not to draw; that holds for a user's EGL as well.
if sys.platform.startswith("linux"):
    if os.environ.get("MUJOCO_GL", "").strip().lower() in ("", "egl"):
        os.environ["MUJOCO_GL"] = "egl" if egl_is_there() else "disable"


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
