"""The folder of proposals, each of which is seen beside the present state before it is accepted."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from twinct.core.errors import TwinctError
from twinct.design import words
from twinct.design.desk import Answer, State
from twinct.design.page.tools import GREEN, Tool, Tools
from twinct.design.proposals import BetterPlaces, BetterViews, Cure, Proposal
from twinct.robots.cell import build_cell
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Scenario
from twinct.viewer.markdown import plain
from twinct.viewer.room import Room
from twinct.viewer.stage import MM

KINDS = {"cure": Cure, "place arms": BetterPlaces, "plan views": BetterViews}
OPACITY = 0.45


class ProposalFolder(Tool):
    """Buttons that ask for proposals, and the newest one."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        self._nodes: list[Any] = []
        self._drawn: Proposal | None = None
        with gui.add_folder("Propose", order=order):
            self._ask = gui.add_button_group("", tuple(KINDS))
            self._about = gui.add_markdown("")
            self._answer = gui.add_button_group("", ("accept", "dismiss"), visible=False)
        tools.pressed(self._ask, self._request)
        tools.pressed(self._answer, self._decide)

    def _request(self, button: str) -> None:
        if not self.bench.draft.problems:
            self.bench.ask(KINDS[button](self.bench.draft.source))

    def _decide(self, button: str) -> None:
        if button == "accept":
            self.tools.attempt(self.bench.accept)
        self._draw(None)
        self._about.content, self._answer.visible = "", False
        self.tools.refresh()

    def hear(self, subject: str, answer: Answer) -> None:
        """Show the proposal beside the present state."""
        if subject != "proposal":
            return
        fresh = answer.state is State.FRESH
        self._answer.visible = fresh
        self._draw(answer.value if fresh else None)
        if fresh:
            self._about.content = words.proposal_in_words(answer.value)
        elif answer.state is State.COMPUTING:
            self._about.content = f"*{plain(answer.progress or 'computing')}*"
        elif answer.state is State.FAILED:
            self._about.content = f"**{plain('; '.join(answer.problems))}**"
        else:
            self._about.content = ""

    def _draw(self, proposal: Proposal | None) -> None:
        """Draw arms and path of a proposal in green, translucent, in the present room."""
        if proposal is self._drawn:
            return
        self._drawn = proposal
        for node in self._nodes:
            node.remove()
        self._nodes = []
        if proposal is None:
            return
        now, then = proposal.now.scenario, proposal.then.scenario
        try:
            if isinstance(then.cell, Cell) and then.cell != now.cell:
                self._draw_arms(then, proposal)
            if then.trajectory != now.trajectory:
                self._draw_path(then)
        except TwinctError as error:
            self._about.content += f"\n\n*it is not drawn: {plain(str(error))}*"

    def _draw_arms(self, scenario: Scenario, proposal: Proposal) -> None:
        assert isinstance(scenario.cell, Cell)
        place = scenario.specimen.world_from_specimen
        room = Room(build_cell(scenario.cell, None, place, scenario.detector.panel))
        plan = proposal.then.motion.plan
        joints = None
        if plan is not None:
            joints = np.asarray(plan.joints[min(self.bench.view, len(plan.joints) - 1)])
        positions, quats = room.at(joints)
        for k, body in enumerate(room.bodies):
            if body.name.startswith(("source", "detector")):
                mesh: trimesh.Trimesh = body.mesh
                self._nodes.append(
                    self.tools.server.scene.add_mesh_simple(
                        f"/design/proposal/{k}",
                        np.asarray(mesh.vertices, np.float32),
                        np.asarray(mesh.faces, np.uint32),
                        color=GREEN,
                        opacity=OPACITY,
                        position=positions[k],
                        wxyz=quats[k],
                    )
                )

    def _draw_path(self, scenario: Scenario) -> None:
        points = SimulationBuilder(scenario).requested.source * MM
        if len(points) > 1:
            lines = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
            self._nodes.append(
                self.tools.server.scene.add_line_segments(
                    "/design/proposal/path", lines, GREEN, thickness=0.004
                )
            )
