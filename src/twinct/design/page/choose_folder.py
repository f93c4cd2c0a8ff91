"""The folder in which arms, room, table, rails, specimen and material are chosen or uploaded."""

from __future__ import annotations

from functools import partial
from typing import Any

from twinct.core.errors import TwinctError
from twinct.design import choices, uploads
from twinct.design.desk import Answer, State
from twinct.design.page.tools import Tool, Tools
from twinct.scenario import Cell, Scenario
from twinct.viewer.markdown import plain
from twinct.viewer.server import accept_uploads

AS_IT_IS = "as it is"
RAIL_END_MM = 3000.0
SIDES = {"source": "source_arm", "detector": "detector_arm"}


class ChooseFolder(Tool):
    """Choice of the room's content, from lists and files."""

    def __init__(self, tools: Tools, order: float) -> None:
        """Add the folder."""
        super().__init__(tools)
        gui = tools.server.gui
        self._waits: uploads.ReceivedSpecimen | None = None
        with gui.add_folder("Choose", order=order, expand_by_default=False):
            self._specimen: Any = gui.add_dropdown(
                "specimen", (AS_IT_IS, *choices.specimen_names())
            )
            self._upload = gui.add_upload_button(
                "upload STL, NIfTI or zipped DICOM",
                hint="Also PLY, OBJ, OFF, MetaImage and InVesalius; at most "
                f"{uploads.LARGEST_UPLOAD // 2**20} MB.",
            )
            self._unit: Any = gui.add_dropdown("unit of a mesh", tuple(uploads.UNITS))
            self._kind: Any = gui.add_dropdown("a CT becomes", uploads.KINDS)
            self._about = gui.add_markdown("")
            self._part: Any = gui.add_dropdown("part", (AS_IT_IS,))
            self._material: Any = gui.add_dropdown("material", choices.all_materials())
            self._room: Any = gui.add_dropdown("room", choices.ROOMS)
            self._table = gui.add_checkbox("table", True)
            self._arms: dict[str, Any] = {}
            self._rails: dict[str, tuple[Any, Any]] = {}
            for side, arm in SIDES.items():
                self._arms[arm] = gui.add_dropdown(f"{side} arm", choices.arm_models())
                on_rail = gui.add_checkbox(f"{side} arm on a rail", False)
                ends = gui.add_multi_slider(
                    f"{side} rail, mm", -RAIL_END_MM, RAIL_END_MM, 50.0, choices.RAIL_MM
                )
                self._rails[arm] = on_rail, ends
        accept_uploads(
            tools.server,
            uploads.LARGEST_UPLOAD,
            lambda name, why: tools.hand.ask(object(), lambda: self._refuse(name, why)),
        )
        tools.on(self._specimen, "specimen", self._choose_specimen)
        tools.on(self._part, "part", lambda _: self._paint_material())
        tools.on(self._material, "material", self._choose_material)
        tools.on(self._room, "room", lambda room: self._choose(choices.of_room, room))
        tools.on(self._table, "table", lambda on: self._choose(choices.of_table, on))
        for arm, handle in self._arms.items():
            tools.on(handle, arm, partial(self._choose, choices.of_arm, arm))
        for arm, pair in self._rails.items():
            for handle in pair:
                tools.on(handle, ("rail", arm), lambda _, arm=arm: self._choose_rail(arm))

        async def came(event: Any) -> None:
            file = event.target.value
            name, content, file.content = file.name, file.content, b""
            tools.hand.ask(object(), lambda: self.receive(name, content))

        self._upload.on_upload(came)

    def _choose(self, of: Any, *values: Any) -> None:
        if self.tools.shown is not None:
            self.tools.change(of(self.tools.shown, *values))

    def _choose_specimen(self, name: str) -> None:
        if name != AS_IT_IS:
            self._specimen.value = AS_IT_IS
            self._choose(choices.of_specimen, name)

    def _choose_material(self, material: str) -> None:
        self._choose(choices.of_material, str(self._part.value), material)

    def _choose_rail(self, arm: str) -> None:
        on_rail, ends = self._rails[arm]
        low, high = ends.value
        self._choose(choices.of_rail, arm, (float(low), float(high)) if on_rail.value else None)

    # Uploads.

    def receive(self, name: str, content: bytes) -> None:
        """Keep a file that a browser has sent, and ask whether it can be the specimen."""
        draft = self.bench.draft
        try:
            path = uploads.kept(draft.path, name, content)
        except TwinctError as error:
            self._refuse(name, str(error))
            return
        unit = uploads.UNITS[str(self._unit.value)]
        self._waits = uploads.ReceivedSpecimen(draft.source, path, str(self._kind.value), unit)
        self.bench.ask(self._waits)

    def _refuse(self, name: str, why: str) -> None:
        self._about.content = f"**{plain(name)}: refused: {plain(why)}**"
        self.tools.tell(f"{name}: refused", why, bad=True)

    def hear(self, subject: str, answer: Answer) -> None:
        """Use a file that the readers accept, and say why they refuse one."""
        waits = self._waits
        if subject != uploads.ReceivedSpecimen.subject or waits is None:
            return
        if answer.state is State.FAILED:
            self._waits = None
            self.tools.attempt(lambda: uploads.forget(waits.path))
            self._refuse(waits.path.name, "; ".join(answer.problems))
        elif answer.question == waits and answer.value is not None:
            self._waits = None
            self._about.content = plain("; ".join(answer.value.words))
            self.tools.attempt(lambda: self.bench.apply(answer.value.edit))
            self.tools.refresh()
        elif answer.state is State.COMPUTING:
            self._about.content = f"*reading {plain(waits.path.name)}*"

    # Painting.

    def paint(self, scenario: Scenario) -> None:
        """Show what is chosen."""
        parts = tuple(choices.materials_of(scenario)) or (AS_IT_IS,)
        if self._part.options != parts:
            self._part.options = parts
            self._part.value = parts[0]
        self._paint_material()
        cell = scenario.cell
        arms = isinstance(cell, Cell)
        for handle in (self._room, self._table, *self._arms.values()):
            handle.visible = arms
        for arm, (on_rail, ends) in self._rails.items():
            rail = getattr(cell, arm).rail if arms else None
            on_rail.visible, ends.visible = arms, rail is not None
            self.put(on_rail, rail is not None)
            if rail is not None:
                self.put(ends, tuple(rail.range_mm))
        if isinstance(cell, Cell):
            self.put(self._room, cell.room)
            self.put(self._table, cell.table.present)
            for arm, handle in self._arms.items():
                model = getattr(cell, arm).model
                if model is not None and model not in handle.options:
                    handle.options = (*handle.options, model)
                handle.visible = model is not None  # an arm from a file has no name
                if model is not None:
                    self.put(handle, model)

    def _paint_material(self) -> None:
        scenario = self.tools.shown
        material = None
        if scenario is not None:
            material = choices.materials_of(scenario).get(str(self._part.value))
        self._material.visible = material is not None
        if material is not None:
            if material not in self._material.options:
                self._material.options = (*self._material.options, material)
            self.put(self._material, material)
