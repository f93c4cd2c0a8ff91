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
    from twinct.calibration.calibrate import calibrate
    from twinct.measured.import_scan import import_scan
    from twinct.measured.prediction import predict
    from twinct.recon.volume import Volume
    from twinct.runs import (
        compare,
        derive_geometry,
        evaluate,
        export,
        load_scan,
        needs,
        reconstruct,
        reconstruct_run,
        rewrite_report,
        run,
        simulate,
        verify,
    )
    from twinct.runs.checking import check
    from twinct.runs.dosing import dose
    from twinct.runs.motion_program import write_motion
    from twinct.runs.reaching import place, reach
    from twinct.runs.scenario_files import draw_view, write_specimen, write_urdf
    from twinct.scenario import load_scenario
    from twinct.study import load_results, run_study
    from twinct.view_plans.effects import effects_of_errors
    from twinct.view_plans.next_view import NextViewEnv
    from twinct.view_plans.planner import plan

__all__ = [
    "__version__",
    "NextViewEnv",
    "Volume",
    "calibrate",
    "check",
    "compare",
    "derive_geometry",
    "dose",
    "draw_view",
    "effects_of_errors",
    "evaluate",
    "export",
    "import_scan",
    "load_results",
    "load_scan",
    "load_scenario",
    "needs",
    "place",
    "plan",
    "predict",
    "reach",
    "reconstruct",
    "reconstruct_run",
    "rewrite_report",
    "run",
    "run_study",
    "simulate",
    "verify",
    "write_motion",
    "write_specimen",
    "write_urdf",
]

_HOMES = {name: "twinct.runs" for name in __all__[1:]} | {
    "NextViewEnv": "twinct.view_plans.next_view",
    "Volume": "twinct.recon.volume",
    "calibrate": "twinct.calibration.calibrate",
    "check": "twinct.runs.checking",
    "dose": "twinct.runs.dosing",
    "draw_view": "twinct.runs.scenario_files",
    "effects_of_errors": "twinct.view_plans.effects",
    "import_scan": "twinct.measured.import_scan",
    "load_results": "twinct.study",
    "load_scenario": "twinct.scenario",
    "place": "twinct.runs.reaching",
    "plan": "twinct.view_plans.planner",
    "predict": "twinct.measured.prediction",
    "reach": "twinct.runs.reaching",
    "run_study": "twinct.study",
    "write_motion": "twinct.runs.motion_program",
    "write_specimen": "twinct.runs.scenario_files",
    "write_urdf": "twinct.runs.scenario_files",
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
