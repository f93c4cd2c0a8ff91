"""Arms that a scenario can name; other packages offer theirs by entry points ``twinct.arms``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

MODELS = Path(__file__).parent / "cell"
"""Folder of the built-in arms."""


@dataclass(frozen=True, eq=False)
class ArmFile:
    """Arm that a scenario can name.

    Attributes:
        name: its name, for the key ``model`` of an arm.
        file: MJCF or URDF of the arm alone.
        keys: values of further keys of the arm that belong to the file, such as ``base``,
            ``flange``, ``link_density_kg_m3`` and ``joint_speed_deg_s``. Keys that the scenario
            sets take precedence.
    """

    name: str
    file: Path
    keys: Mapping[str, Any] = field(default_factory=dict[str, Any])


BUILT_IN = {name: ArmFile(name, MODELS / f"{name}.xml") for name in ("ur10e", "lbr_iiwa14")}
