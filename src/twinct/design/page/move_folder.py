"""The folder that moves bodies, by a gizmo or by typed numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.design.movable import Movable, movables
from twinct.design.page.tools import Tool, Tools
from twinct.geometry import Pose
from twinct.scenario import Scenario

NOTHING = "nothing"
GIZMO_M = 0.25


class MoveFolder(Tool):
    """One body at a time is moved."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder and the gizmo."""
        super().__init__(tools)
        gui = tools.server.gui
        with gui.add_folder("Move", order=order):
            self._body: Any = gui.add_dropdown("body", (NOTHING,))
            self._at = gui.add_vector3("position, mm", (0.0, 0.0, 0.0), visible=False)
            self._turned = gui.add_vector3("rotation, deg", (0.0, 0.0, 0.0), visible=False)
            self._snap_mm = gui.add_number("snap, mm", 10.0, min=0.0)
            self._snap_deg = gui.add_number("snap, deg", 5.0, min=0.0)
        self.gizmo = self._add_gizmo(turns=True)
        tools.on(self._body, "body", lambda _: self._paint_chosen())
        tools.on(self._at, "typed place", lambda at: self._typed(at=at))
        tools.on(self._turned, "typed turn", lambda turned: self._typed(turned=turned))

    def _add_gizmo(self, *, turns: bool) -> Any:
        self._turns = turns
        gizmo = self.tools.server.scene.add_transform_controls(
            "/design/gizmo",
            scale=GIZMO_M,
            disable_rotations=not turns,
            visible=False,
            depth_test=False,
        )

        async def dragged(event: Any) -> None:
            if event.phase == "end":
                self.tools.hand.ask("dropped", self.drop)

        gizmo.on_update(dragged)
        return gizmo

    def chosen(self) -> Movable | None:
        """Return the chosen body."""
        scenario = self.tools.shown
        known = () if scenario is None else movables(scenario)
        return next((one for one in known if one.name == self._body.value), None)

    def _typed(self, at: Any = None, turned: Any = None) -> None:
        """Move the chosen body to the typed numbers."""
        body = self.chosen()
        if body is not None:
            pose = Pose.from_euler(
                body.position_mm if at is None else at,
                body.rotation_deg if turned is None else turned,
            )
            by = (self._at, self._turned)
            self.tools.change(dict(body.moved(pose)), ("typed", body.name), by)

    def drop(self) -> None:
        """Move the chosen body to the gizmo."""
        body = self.chosen()
        if body is not None:
            w, x, y, z = self.gizmo.wxyz
            pose = Pose.from_metres(self.gizmo.position, (x, y, z, w))
            steps = float(self._snap_mm.value), float(self._snap_deg.value)
            self.tools.change(dict(body.moved(pose, *steps)))

    def paint(self, scenario: Scenario) -> None:
        """Offer the bodies, and show the place of the chosen one."""
        names = (NOTHING, *(one.name for one in movables(scenario)))
        if self._body.options != names:
            chosen = self._body.value
            self._body.options = names
            self._body.value = chosen if chosen in names else NOTHING
        self._paint_chosen()

    def _paint_chosen(self) -> None:
        """Show gizmo and numbers of the chosen body."""
        body = self.chosen()
        turns = body is not None and bool(body.rotation_key)
        if body is not None and turns != self._turns:
            self.gizmo.remove()
            self.gizmo = self._add_gizmo(turns=turns)
        for handle, visible in (
            (self.gizmo, body is not None),
            (self._at, body is not None),
            (self._turned, turns),
        ):
            if handle.visible != visible:
                handle.visible = visible
        if body is None:
            return
        position, quat = body.pose.to_metres()
        self.gizmo.position, self.gizmo.wxyz = position, quat[[3, 0, 1, 2]]
        for handle, numbers in ((self._at, body.position_mm), (self._turned, body.rotation_deg)):
            if tuple(handle.value) != tuple(numbers) and handle not in self.tools.by:
                handle.value = np.asarray(numbers, float)
