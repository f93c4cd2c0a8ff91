"""Parts of twinct that a machine may lack, and a try of each."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass

from twinct.core.errors import InputError
from twinct.core.extras import require

_TRY = """
import sys
from twinct.core.errors import TwinctError
try:
    {code}
except TwinctError as error:
    sys.exit(str(error))
"""
_GVXR = 'from twinct.xray import prepare_engine; prepare_engine("gvxr")'
_PICTURE = """
    import tempfile
    from pathlib import Path
    from twinct.robots.cell.render import check_drawing, render_cell
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario
    check_drawing()
    ball = {"shape": {"kind": "sphere", "radius_mm": 20}, "material": "bone"}
    cell = SimulationBuilder(load_scenario("demo", {"specimen.parts": [ball]})).cell
    with tempfile.TemporaryDirectory() as folder:
        render_cell(cell, Path(folder) / "room.png", width=64, height=48)
"""


@dataclass(frozen=True)
class Part:
    """A part of twinct that works without the others.

    Attributes:
        name: name of the part.
        purpose: what it is for.
        attempt: raises InputError with what to type if the part does not work here.
    """

    name: str
    purpose: str
    attempt: Callable[[], object]


def try_gvxr() -> None:
    """Raise if gVXR is missing or cannot draw."""
    require("xray")
    _elsewhere(_GVXR)


def _try_picture() -> None:
    require("robots")
    _elsewhere(_PICTURE)


def _try_card() -> None:
    from twinct.core.card import device

    device()


def _try_ros() -> None:
    from twinct.link import require_ros

    require_ros()


def _elsewhere(code: str) -> None:
    """Run code in another process: a library may end it, and gVXR keeps 2 GB.

    Raises:
        InputError: the code ended with an error.
    """
    command = [sys.executable, "-P", "-c", _TRY.format(code=code)]
    tried = subprocess.run(command, capture_output=True, text=True)
    if tried.returncode:
        lines = tried.stderr.strip().splitlines()
        raise InputError(lines[0] if lines else f"it ended with {tried.returncode}")


def _extra(name: str) -> Callable[[], object]:
    return lambda: require(name)


PARTS = (
    Part("arms", "two robot arms", _extra("robots")),
    Part("engine gvxr", "projections with OpenGL, the default", try_gvxr),
    Part("engine mesh", "projections with rays of our own", lambda: None),
    Part("engine cuda_mesh, cuda", "projections and reconstruction on a card", _try_card),
    Part("link ros2", "both simulations as ROS 2 nodes", _try_ros),
    Part("link local", "both simulations in one process", lambda: None),
    Part("picture of the room", "in reports, and by twinct render", _try_picture),
    Part("page and film", "twinct view", _extra("view")),
    Part("studies", "twinct study", _extra("study")),
    Part("cluster", "twinct study --address", _extra("cluster")),
    Part("planned views", "twinct plan", _extra("planning")),
    Part("recordings", "twinct run --record, twinct import FILE.mcap", _extra("record")),
    Part("HDF5", "measured projections in HDF5 files", _extra("hdf5")),
    Part("macros of arms", "twinct arm FILE.xacro", _extra("xacro")),
    Part("rtk", "RTK as a second reconstruction", _extra("rtk")),
)
"""All parts, in the order in which newcomers meet them."""
