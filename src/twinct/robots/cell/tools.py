"""Tube and panel as bodies at a flange: housings of usual size, or the shapes of a tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.geometry import Floats, Panel, Pose
from twinct.robots.cell.solids import LOOK_ONLY, MM, add_box, add_rod, add_shape
from twinct.robots.sections import Tool
from twinct.specimen.room_bodies import closed_surface_of

if TYPE_CHECKING:
    import mujoco
    import trimesh

PANEL_BORDER_MM = 10.0
PANEL_DEPTH_MM = 24.0
PANEL_COVER_MM = 4.0
"""Housing of the active area: border, total depth, and depth of the cover before the pixels."""

SPACER_MM = 50.0
"""Radius of the spacer between flange and tool, that of the flange of an arm for 10 to 20 kg."""

ACTIVE_MM = 0.4
"""Thickness of the sheet that marks the active area in pictures."""


def add_tool(
    spec: mujoco.MjSpec,
    body: Any,
    side: str,
    tool: Tool | None,
    standoff_mm: float,
    mass_kg: float,
    panel: Panel,
    key: str,
) -> None:
    """Add shapes, mass and the site of focal spot or panel to a body at a flange.

    Args:
        spec: the model.
        body: body at the flange, z away from the arm.
        side: ``source`` or ``detector``, the name of the site.
        tool: its shapes; None: the usual housing.
        standoff_mm: distance of focal spot or panel from the flange, along its axis.
        mass_kg: mass of all of it.
        panel: pixel lattice, which determines the size of the housing.
        key: key of the machine that carries it, for messages.

    Raises:
        ScenarioError: the stand-off leaves no room for the tool.
        SpecimenError: a mesh file is unusable.
    """
    if tool is not None:
        _described(spec, body, side, tool, standoff_mm, mass_kg, panel, key)
    elif side == "source":
        _tube(body, standoff_mm, mass_kg)
    else:
        _panel(body, standoff_mm, mass_kg, panel, key)


def flange_from_tip(tool: Tool | None, standoff_mm: float) -> Pose:
    """Return the pose of focal spot or active area at the flange."""
    if tool is None:
        return Pose(np.array([0.0, 0.0, standoff_mm]), Pose.identity().quat)
    tip = tool.tool_from_tip
    return Pose(np.array([*tip.position[:2], standoff_mm]), tip.quat)


def _described(
    spec: mujoco.MjSpec,
    body: Any,
    side: str,
    tool: Tool,
    standoff_mm: float,
    mass_kg: float,
    panel: Panel,
    key: str,
) -> None:
    spacer = standoff_mm - tool.tip_mm[2]
    if spacer < -1e-9:
        raise ScenarioError(
            f"{key}.standoff_mm = {standoff_mm:g} mm leaves no room for the tool, whose tip_mm "
            f"lies at z = {tool.tip_mm[2]:g} mm: at least as much is needed; the rest is a spacer"
        )
    flange_from_tool = Pose(np.array([0.0, 0.0, max(spacer, 0.0)]), Pose.identity().quat)
    if spacer > 1e-3:
        add_rod(body, f"{side}_spacer", (0, 0, 0), (0, 0, spacer), SPACER_MM, "steel")
    solids: list[trimesh.Trimesh] = []
    for index, part in enumerate(tool.parts):
        place, owner = flange_from_tool @ part.tool_from_part, f"{key}.tool.parts.{index}"
        position, quat = place.to_metres()
        name = f"{side}_tool_{index}"
        look: dict[str, Any] = {"pos": position, "quat": np.roll(quat, 1)}
        add_shape(spec, body, name, part.shape, owner, rgba=part.rgba, **look)
        surface = closed_surface_of(part.shape, owner).copy()
        surface.apply_transform(place.matrix)
        solids.append(surface)
    centre, inertia = _of_one_density(solids, mass_kg)
    if tool.centre_of_mass_mm is not None:
        centre = flange_from_tool.apply(np.array(tool.centre_of_mass_mm))
    body.mass, body.ipos, body.explicitinertial = mass_kg, centre * MM, True
    xx, yy, zz, xy, xz, yz = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)] * MM**2
    body.fullinertia = [xx, yy, zz, xy, xz, yz]
    tip = flange_from_tip(tool, standoff_mm)
    position, quat = tip.to_metres()
    if side == "detector":
        sheet = (tip @ Pose(np.array([0.0, 0.0, PANEL_COVER_MM]), Pose.identity().quat)).position
        more = {**LOOK_ONLY, "quat": np.roll(quat, 1)}
        add_box(body, "detector_active", sheet, (*panel.size_mm, ACTIVE_MM), "active", **more)
    body.add_site(name=side, pos=position, quat=np.roll(quat, 1), group=4)


def _of_one_density(solids: Sequence[trimesh.Trimesh], mass_kg: float) -> tuple[Floats, Floats]:
    """Return centre of mass, mm, and inertia about it, kg mm^2, of solids of one density."""
    volumes = np.array([solid.volume for solid in solids])
    masses = mass_kg * volumes / volumes.sum()
    centres = np.array([solid.center_mass for solid in solids])
    centre = masses @ centres / mass_kg
    inertia = np.zeros((3, 3))
    for solid, mass, at in zip(solids, masses, centres - centre, strict=True):
        inertia += solid.moment_inertia * mass / solid.volume  # trimesh: of density 1
        inertia += mass * (at @ at * np.eye(3) - np.outer(at, at))
    return centre, inertia


def _tube(body: Any, standoff_mm: float, mass: float) -> None:
    """Add a tube housing; the focal spot lies 20 mm behind its front, z exits by the window."""
    s = standoff_mm
    adapter = min(15.0, 0.1 * s)
    front = s + 20
    add_rod(body, "source_adapter", (0, 0, 0), (0, 0, adapter), 50, "steel", mass=0.1 * mass)
    length = front - adapter - 8
    centre = (0, 0, adapter + length / 2)
    add_box(body, "source_housing", centre, (96, 96, length), "tube", mass=0.85 * mass)
    add_rod(body, "source_window", (0, 0, front - 8), (0, 0, front), 38, "accent", mass=0.05 * mass)
    body.add_site(name="source", pos=[0, 0, s * MM], group=4)


def _panel(body: Any, standoff_mm: float, mass: float, panel: Panel, key: str) -> None:
    """Add a flat panel on a bracket; the pixel plane lies 4 mm behind the cover's front."""
    s = standoff_mm
    width, height = (edge + 2 * PANEL_BORDER_MM for edge in panel.size_mm)
    back = s + PANEL_COVER_MM - PANEL_DEPTH_MM
    if back < 20:
        raise ScenarioError(
            f"{key}.standoff_mm = {s:g} mm leaves no room for the panel's housing: at "
            f"least {20 + PANEL_DEPTH_MM - PANEL_COVER_MM:g} mm are needed"
        )
    add_rod(body, "detector_adapter", (0, 0, 0), (0, 0, 12), 50, "steel", mass=0.1 * mass)
    add_rod(body, "detector_bracket", (0, 0, 12), (0, 0, back), 36, "tube", mass=0.1 * mass)
    centre, size = s + PANEL_COVER_MM - PANEL_DEPTH_MM / 2, (width, height, PANEL_DEPTH_MM)
    add_box(body, "detector_panel", (0, 0, centre), size, "housing", mass=0.8 * mass)
    active = (*panel.size_mm, ACTIVE_MM)
    look = {**LOOK_ONLY, "mass": 0.0}
    add_box(body, "detector_active", (0, 0, s + PANEL_COVER_MM), active, "active", **look)
    body.add_site(name="detector", pos=[0, 0, s * MM], group=4)
