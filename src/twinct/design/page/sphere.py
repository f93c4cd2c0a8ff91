"""The sphere of directions, shaded by what the arms reach."""

from __future__ import annotations

import numpy as np

from twinct.design.desk import Answer, State
from twinct.design.page.tools import GREEN, RED, Tool, Tools
from twinct.design.questions import Shading
from twinct.viewer.stage import MM

BOTH, ONE, NONE = GREEN, (240, 170, 40), RED
"""Colours of directions that both arms, one arm, and no arm can hold."""

DOT_M = 0.008


class Sphere(Tool):
    """A dot for each direction."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the switch."""
        super().__init__(tools)
        self._shaded: Shading | None = None
        gui = tools.server.gui
        self._on = gui.add_checkbox("sphere of directions", True, order=order)
        self._legend = gui.add_markdown("", order=order + 0.01)
        tools.on(self._on, "sphere", lambda _: self.hear("sphere", self.bench.answer("sphere")))

    def hear(self, subject: str, answer: Answer) -> None:
        """Draw the newest shading, and ask for a finer one."""
        if subject != "sphere":
            return
        shading: Shading | None = answer.value
        if not self._on.value or answer.state is State.FAILED:
            shading = None
        if shading is not self._shaded:
            self._shaded = shading
            self._draw(shading)
        if answer.state is State.FRESH and shading is not None:
            self.bench.refine()

    def _draw(self, shading: Shading | None) -> None:
        scene = self.tools.server.scene
        if shading is None:
            scene.remove_by_name("/design/sphere")
            self._legend.content = ""
            return
        held, both = shading.alone.sum(axis=0), 100 * float(shading.both.mean())
        self._legend.content = (
            f"source directions at this radius: green, both arms ({both:.0f} %); orange, one arm "
            "only or not both at once; red, none"
        )
        colours = np.where(shading.both[:, None], BOTH, np.where(held[:, None] > 0, ONE, NONE))
        points = (shading.isocentre_mm + shading.sod_mm * shading.directions) * MM
        scene.add_point_cloud(
            "/design/sphere",
            points.astype(np.float32),
            colors=colours.astype(np.uint8),
            point_size=DOT_M,
            point_shape="circle",
        )
