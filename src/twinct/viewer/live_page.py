"""The page: controls, curves and pictures beside the scene, all painted by one thread.

Callbacks of browsers and events of a run only record requests. The painter takes the newest
request, so that a dragged slider, a fast run or a slow browser skips views and never queues them.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Condition, Thread
from threading import Event as Signal
from typing import Any

import numpy as np

from twinct.geometry import Floats
from twinct.scan import Simulated
from twinct.viewer.curves import Chart, curves
from twinct.viewer.markdown import plain
from twinct.viewer.numbers import (
    nearest_view,
    of_joints,
    of_pixel,
    of_point,
    of_view,
    of_voxel,
    on_surface,
)
from twinct.viewer.room import Room
from twinct.viewer.scenery import set_lights
from twinct.viewer.server import Server
from twinct.viewer.show import RECONSTRUCTION, TRUTH, Show
from twinct.viewer.slices import AXES
from twinct.viewer.stage import DIFFERENCE, IN_FRONT_MM, NOTHING, Look, Stage, colour_of
from twinct.viewer.surface import dense_surface
from twinct.viewer.tiles import slices_beside

log = logging.getLogger(__name__)

APART_M = 2.8
"""Distance between the isocentres of two runs side by side."""

FASTEST_HZ = 30.0
"""Maximum number of paintings per second."""

BROWSER_COMES_S, BROWSER_DRAWS_S = 2.0, 2.0
"""Time for a first browser to connect, and then to draw, before heavy work begins."""

SURFACE_SHARE = 0.5
"""Initial level of the surface, as a share of the densest material in the window."""

HANGS_S = 60.0
"""Time that closing waits for the painter, which a large surface keeps busy for seconds."""


@dataclass
class _Wishes:
    """Requests since the last painting."""

    shows: dict[int, Show] = field(default_factory=dict)
    rooms: dict[int, Room] = field(default_factory=dict)
    specimens: dict[int, Any] = field(default_factory=dict)
    fields: dict[int, Any] = field(default_factory=dict)
    joints: dict[int, Floats] = field(default_factory=dict)
    look: bool = False
    said: str | None = None
    ended: bool = False

    def __bool__(self) -> bool:
        return bool(
            self.shows or self.rooms or self.specimens or self.fields or self.joints
        ) or self.look or self.said is not None or self.ended  # fmt: skip


class Page:
    """The page that all browsers share.

    Attributes:
        server: the server.
        stages: the runs in the scene.
        side: panel with tabs beside the scene.
    """

    def __init__(self, server: Server, runs: int = 1, *, live: bool = False) -> None:
        """Build an empty page for one or two runs; ``live`` initially follows the newest view."""
        self.server = server
        self._changed = Condition()
        self._wishes = _Wishes()
        self._shows: list[Show | None] = [None] * runs
        half = APART_M * (runs - 1) / 2
        self.stages = [
            Stage(server, f"run{k}", np.array([APART_M * k - half, 0.0, 0.0])) for k in range(runs)
        ]
        for k, stage in enumerate(self.stages):
            stage.clicked = lambda *click, k=k: self._select(k, *click)
        self._look = Look()
        self._painted: Look | None = None
        self._selected = 0
        self._surface: tuple[Any, ...] = ()
        self._tiles: tuple[Any, ...] = ()
        self._curves: list[tuple[Chart, Any]] = []
        self._busy = False
        self._playing = False
        self._mute = False
        self._opened = Signal()
        server.on_client_connect(lambda _: self._opened.set())
        self._build(live)
        self._thread = Thread(target=self._paint_on, name="page", daemon=True)
        self._thread.start()

    # Updates from the run; each call returns at once.

    def put(self, run: int, show: Show) -> None:
        """Show the current state of a run."""
        self._wish(lambda wishes: wishes.shows.__setitem__(run, show))

    def put_room(self, run: int, room: Room) -> None:
        """Show the bodies of a run's room."""
        self._wish(lambda wishes: wishes.rooms.__setitem__(run, room))

    def put_specimen(self, run: int, mesh: Any) -> None:
        """Show the surface of a run's specimen, mm, in its own frame."""
        self._wish(lambda wishes: wishes.specimens.__setitem__(run, mesh))

    def put_field(self, run: int, mesh: Any) -> None:
        """Show the region that every view sees, mm."""
        self._wish(lambda wishes: wishes.fields.__setitem__(run, mesh))

    def move(self, run: int, joints: Floats) -> None:
        """Show a run's arms during a move."""
        self._wish(lambda wishes: wishes.joints.__setitem__(run, joints))

    def say(self, text: str) -> None:
        """Show a status line."""
        self._wish(lambda wishes: setattr(wishes, "said", text))

    def show_view(self, view: int) -> None:
        """Go to a view, like the slider."""
        self._view.value = int(np.clip(view, 0, self._view.max))

    @property
    def below_head(self) -> float:
        """Order of controls that stand between the heading and the other controls."""
        return float(self._head.order) + 0.5

    def watch_view(self, told: Callable[[int], object]) -> None:
        """Call a function with the index of the view whenever it changes."""

        async def heard(_: Any) -> None:
            told(int(self._view.value))

        self._view.on_update(heard)

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until all requests are painted; return False on timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._wishes and not self._busy, timeout_s)

    def let_draw(self) -> None:
        """Wait for a browser's first drawing, which other work here would delay."""
        if self._opened.wait(BROWSER_COMES_S):
            time.sleep(BROWSER_DRAWS_S)

    def close(self) -> None:
        """Stop painting."""
        self._wish(lambda wishes: setattr(wishes, "ended", True))
        self._thread.join(HANGS_S)

    @property
    def look(self) -> Look:
        """Current look."""
        return self._look

    @property
    def shows(self) -> Sequence[Show]:
        """Runs on the page."""
        return [show for show in self._shows if show is not None]

    def _wish(self, wish: Callable[[_Wishes], Any]) -> None:
        with self._changed:
            wish(self._wishes)
            self._changed.notify_all()

    # The controls.

    def _build(self, live: bool) -> None:
        gui = self.server.gui
        set_lights(self.server, len(self.stages))

        self._head = gui.add_markdown("")
        with gui.add_folder("View"):
            self._view = gui.add_slider("view", 0, 1, 1, 0)
            self._buttons = gui.add_button_group("", ("play", "pause", "back", "next"))
            self._rate = gui.add_number("views a second", 10.0, min=0.5, max=FASTEST_HZ, step=0.5)
            self._follow = gui.add_checkbox("follow the scan", live, visible=live)
        with gui.add_folder("Geometry"):
            self._geometry: Any = gui.add_dropdown("beam and panel", (Simulated.kept,))
            self._factor = gui.add_slider(
                "magnify differences",
                1,
                200,
                1,
                1,
                hint="Magnified about that of the images.",
            )
            self._beam = gui.add_checkbox("beam", True)
            self._paths = gui.add_checkbox("paths of the source", True)
            self._specimen = gui.add_checkbox("specimen", True)
        self._volume = gui.add_folder("Volume", visible=False)
        with self._volume:
            self._shown: Any = gui.add_dropdown("slices of", (RECONSTRUCTION,))
            self._planes = tuple(gui.add_slider(axis, 0, 1, 1, 0) for axis in AXES)
            self._window = gui.add_multi_slider("window, 1/mm", 0.0, 1.0, 0.001, (0.0, 1.0))
            self._surface_of: Any = gui.add_dropdown("surface of", (NOTHING,))
            self._level = gui.add_number("at, 1/mm", 0.02, min=0.0, step=0.001)
        with gui.add_folder("Selected"):
            self._numbers = gui.add_markdown("*Click a path, the panel, a slice or an arm.*")
        self.side = gui.add_panel()
        self._slices_tab = self.side.add_tab("Slices")
        self._curves_tab = self.side.add_tab("Curves")
        self.side.dock_left()
        self.side.set_width(430)
        gui.main_panel.dock_right()
        with self._slices_tab:
            self._sheet = gui.add_image(np.full((8, 8, 3), 255, np.uint8), visible=False)
            self._no_slices = gui.add_markdown("*No volume yet.*")

        for handle in (
            *(self._view, self._geometry, self._factor, self._beam, self._paths, self._specimen),
            *(self._shown, *self._planes, self._window, self._surface_of, self._level),
        ):
            handle.on_update(lambda _: self._look_again())

        # Async, to run in the server's loop, which keeps clicks in order; its threads do not.
        @self._buttons.on_click
        async def _(_: Any) -> None:
            self._press(str(self._buttons.value))

    def _press(self, button: str) -> None:
        if button in ("play", "pause"):
            with self._changed:
                self._playing = button == "play"
                self._changed.notify_all()
        else:
            self._step(1 if button == "next" else -1)

    def _step(self, by: int) -> None:
        views = int(self._view.max) + 1
        self._view.value = (int(self._view.value) + by) % views

    def _look_again(self) -> None:
        if not self._mute:
            self._wish(lambda wishes: setattr(wishes, "look", True))

    def _read_controls(self) -> Look:
        low, high = self._window.value
        x, y, z = (int(plane.value) for plane in self._planes)
        return Look(
            view=int(self._view.value),
            geometry=str(self._geometry.value),
            factor=float(self._factor.value),
            beam=bool(self._beam.value),
            paths=bool(self._paths.value),
            specimen=bool(self._specimen.value),
            shown=str(self._shown.value),
            slices=(x, y, z),
            window=(float(low), float(high)),
            surface=str(self._surface_of.value),
            level=float(self._level.value),
        )

    # The painter.

    def _paint_on(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                while not self._wishes and not self._playing:
                    self._changed.wait()
                if self._playing:
                    self._await_beat(1.0 / max(float(self._rate.value), 0.1))
                wishes, self._wishes = self._wishes, _Wishes()
                self._busy = True
                if self._playing and not wishes:
                    wishes.look = True
                    step = True
                else:
                    step = False
            if wishes.ended:
                with self._changed:
                    self._busy = False
                    self._changed.notify_all()
                return
            start = time.monotonic()
            try:
                if step:
                    self._mute = True
                    self._step(1)
                    self._mute = False
                self._paint(wishes)
            except Exception as error:
                self._mute = False
                log.exception("the page could not be painted")
                self._complain(f"could not be drawn: {error}")
            rest = 1.0 / FASTEST_HZ - (time.monotonic() - start)
            if rest > 0:
                time.sleep(rest)

    def _await_beat(self, beat_s: float) -> None:
        """Wait until the next view of the playback is due, or a request comes."""
        self._changed.wait_for(lambda: self._wishes, beat_s)

    def _complain(self, text: str) -> None:
        self._head.content = f"{self._head.content}\n\n**{plain(text)}**"

    def _paint(self, wishes: _Wishes) -> None:
        with self.server.atomic():
            anew = self._take(wishes)
            self._look = self._read_controls()
            before = None if anew else self._painted
            other_view = before is None or before.view != self._look.view
            if self.shows:
                for stage, show in zip(self.stages, self._shows, strict=True):
                    if show is not None:
                        stage.draw(show, self._look, before)
                self._painted = self._look
                if other_view:
                    self._mark_curves(anew)
            for run, joints in wishes.joints.items():
                self.stages[run].move(joints)
        if self.shows:
            self._paint_sheet()
            self._paint_surfaces()
            if other_view:
                self._paint_numbers()

    def _take(self, wishes: _Wishes) -> bool:
        """Apply the requests; return True if everything has to be redrawn."""
        for run, show in wishes.shows.items():
            before, self._shows[run] = self._shows[run], show
            self._fit_controls(show, before)
        for run, room in wishes.rooms.items():
            if (show := self._shows[run]) is not None:
                self.stages[run].set_room(show, room)
        for run, mesh in wishes.specimens.items():
            self.stages[run].set_specimen(mesh)
        for run, mesh in wishes.fields.items():
            self.stages[run].set_field_of_view(mesh)
        if wishes.said is not None or wishes.shows:
            lines = [f"### {plain(show.name)}\n{plain(show.state)}" for show in self.shows]
            problems = [f"**{plain(p)}**" for show in self.shows for p in show.problems]
            notes = [plain(wishes.said)] if wishes.said else []
            self._head.content = "\n\n".join([*lines, *notes, *problems])
        return bool(wishes.shows or wishes.rooms or wishes.specimens)

    def _fit_controls(self, show: Show, before: Show | None) -> None:
        """Offer the available data in the controls."""
        self._mute = True
        self._specimen.visible = any(one.cell is not None for one in self.shows)
        views = max(len(one) for one in self.shows)
        self._view.max = max(views - 1, 1)
        names = tuple(dict.fromkeys(n for one in self.shows for n in one.geometries))
        if self._geometry.options != names:
            known, wanted = self._geometry.options, self._geometry.value
            self._geometry.options = names
            taken = show.kept in names and (before is None or show.kept not in known)
            valid = wanted if wanted in names else names[-1]
            self._geometry.value = show.kept if taken else valid
        if self._follow.value and show.acquired > (before.acquired if before else 0):
            self._view.value = show.acquired - 1
        volumes = tuple(dict.fromkeys(n for one in self.shows for n in one.volumes))
        old = tuple(before.volumes) if before else ()
        if volumes and set(volumes) - set(old):
            self._offer_volumes(show, volumes)
        self._mute = False

    def _offer_volumes(self, show: Show, names: tuple[str, ...]) -> None:
        first = not self._volume.visible
        self._volume.visible = True
        both = RECONSTRUCTION in names and TRUTH in names
        self._shown.options = (*names, *((DIFFERENCE,) if both else ()), NOTHING)
        self._surface_of.options = (NOTHING, *names)
        if RECONSTRUCTION in names and self._shown.value not in (RECONSTRUCTION, DIFFERENCE):
            self._shown.value = RECONSTRUCTION
        elif first:
            self._shown.value = names[0]
        grid = next(iter(show.volumes.values())).grid
        for plane, n in zip(self._planes, grid.shape_xyz, strict=True):
            if plane.max != n - 1:
                plane.max = n - 1
                plane.value = n // 2
        if first:  # the specimen would hide the slices
            self._specimen.value = False
        if first or TRUTH in names:
            low, high = show.window()
            self._window.max = round(2 * high, 4)
            self._window.min = round(4 * low, 4)
            self._window.value = (round(low, 3), round(high, 3))
            self._level.value = round(SURFACE_SHARE * high / 1.3, 4)

    def _paint_sheet(self) -> None:
        look = self._look
        volumes = [id(v) for show in self.shows for v in show.volumes.values()]
        wanted = (look.slices, look.window, volumes)
        if wanted == self._tiles:
            return
        self._tiles = wanted
        sheet = slices_beside(self.shows, look)
        if sheet is not None:
            self._sheet.image = sheet
            self._sheet.visible, self._no_slices.visible = True, False

    def _paint_surfaces(self) -> None:
        look = self._look
        volumes = [show.volumes.get(look.surface) for show in self.shows]
        wanted = (look.surface, look.level, [id(volume) for volume in volumes])
        if wanted == self._surface:
            return
        self._surface = wanted
        for stage, show in zip(self.stages, self._shows, strict=True):
            volume = show.volumes.get(look.surface) if show is not None else None
            mesh = None
            if volume is not None:
                mesh = dense_surface(volume.array, volume.grid, look.level)
            stage.set_surface(mesh)

    def _mark_curves(self, anew: bool) -> None:
        if anew and self._lay_curves(curves(self.shows)):
            return
        for curve, plot in self._curves:
            if curve.over_views:
                plot.data = (curve.x, *curve.series.values(), curve.marked(self._look.view))

    def _lay_curves(self, curves_shown: list[Chart]) -> bool:
        """Update the plots; return True if they were made anew because the series have changed."""
        known = [(c.title, tuple(c.series)) for c, _ in self._curves]
        if known == [(c.title, tuple(c.series)) for c in curves_shown]:
            self._curves = [
                (c, plot) for c, (_, plot) in zip(curves_shown, self._curves, strict=True)
            ]
            for curve, plot in self._curves:
                if not curve.over_views:
                    plot.data = (curve.x, *curve.series.values())
            return False
        for _, plot in self._curves:
            plot.remove()
        with self._curves_tab:
            self._curves = [(curve, self._plot(curve)) for curve in curves_shown]
        return True

    def _plot(self, curve: Chart) -> Any:
        series: list[Any] = [{"label": "view" if curve.over_views else "iteration"}]
        for name in curve.series:
            shade = _ink(colour_of(name.partition(":")[2].strip().split(",")[0], self.shows[0])) \
                if ":" in name else _ink(colour_of(name.split(",")[0], self.shows[0]))  # fmt: skip
            dash = (4, 3) if name.endswith("panel") else ()
            series.append({"label": name, "stroke": shade, "width": 1.5, "dash": dash})
        data = (curve.x, *curve.series.values())
        if curve.over_views:
            points = {"show": True, "size": 9, "fill": "#c4501b"}
            series.append({"label": "shown", "stroke": "#c4501b", "width": 0, "points": points})
            data = (*data, curve.marked(self._look.view))
        return self.server.gui.add_uplot(
            data=data, series=tuple(series), title=curve.title, aspect=1.7,
            scales={"x": {"time": False}},
        )  # fmt: skip

    # Selection by clicks.

    def _select(self, run: int, kind: str, detail: str, origin: Floats, along: Floats) -> None:
        """Show the numbers of a clicked object; called in a thread of viser."""
        show = self._shows[run]
        if show is None:
            return
        look, stage = self._look, self.stages[run]
        view = min(look.view, len(show) - 1)
        text: str | None = None
        if kind == "path":
            nearest = nearest_view(show, detail, origin, along)
            if nearest is not None:
                self._selected = run
                self.show_view(nearest)
                text = of_view(show, nearest)
        elif kind == "projection":
            _, drawn, _ = stage.shown_geometry(show, look, view)
            text = of_pixel(show, drawn, view, origin, along, IN_FRONT_MM)
        elif kind == "slice":
            axis = AXES.index(detail)
            text = of_voxel(show, axis, look.slices[axis], origin, along)
        elif kind == "surface":
            point = on_surface(show, look.surface, look.level, origin, along)
            text = None if point is None else of_point(show, point, "surface")
        elif kind == "specimen":
            point = on_surface(show, TRUTH, 0.5 * show.window()[1] / 1.3, origin, along)
            text = "**specimen**" if point is None else of_point(show, point, "specimen")
        else:
            text = of_joints(show, view, detail)
        if text is not None:
            self._numbers.content = text

    def _paint_numbers(self) -> None:
        """Show the view's numbers of the run in which a view was last clicked."""
        show = self._shows[self._selected]
        if show is not None:
            self._numbers.content = of_view(show, min(self._look.view, len(show) - 1))


def _ink(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
