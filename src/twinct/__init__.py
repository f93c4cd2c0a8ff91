"""Simulation of twin robotic CT: two arms, X-ray projections, ROS 2, reconstruction, judgement.

Everything public is imported from its module; ``simulate`` and ``reconstruct`` are here because a
notebook starts with them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twinct.runs import reconstruct, simulate
    from twinct.scenario import load_scenario

__version__ = "0.1.0"
__all__ = ["__version__", "load_scenario", "reconstruct", "simulate"]

_HOMES = {
    "load_scenario": "twinct.scenario",
    "reconstruct": "twinct.runs",
    "simulate": "twinct.runs",
}


def __getattr__(name: str) -> Any:
    """Import the entry points on first use, so that ``import twinct`` needs no engine."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'twinct' has no attribute {name!r}")
