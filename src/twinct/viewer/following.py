"""Live update of the page, from a run's folder or as an observer in the run's process."""

from __future__ import annotations

import logging
from pathlib import Path
from threading import Event as Signal
from threading import Thread

from twinct.core.errors import InputError
from twinct.observers import (
    Event,
    IterationDone,
    JointSample,
    Missed,
    Observer,
    PlanMade,
    Said,
    StageBegan,
    StageEnded,
    StageStep,
    ViewStored,
)
from twinct.scan import SimulationBuilder
from twinct.viewer.filling import fill
from twinct.viewer.live_page import Page
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.show import Show

log = logging.getLogger(__name__)

LOOKS_APART_S = 0.4
"""Time between two looks into a folder that another process may write."""

JOINTS_HZ = 10.0

HANGS_S = 60.0
"""Time that the end waits for the last look, without which the page would lack the last views."""


class FolderPoller:
    """Poller of a run's folder, which puts new data on the page."""

    def __init__(self, page: Page, run: int, folder: RunFolder, shown: Show) -> None:
        """Start polling; ``shown`` is the current content of the page."""
        self._page, self._run, self.folder = page, run, folder
        self._shown = shown
        self._nudged, self._ended = Signal(), False
        self._lost = ""
        self._thread = Thread(target=self._follow, name="follower", daemon=True)
        self._thread.start()

    def nudge(self) -> None:
        """Look at once."""
        self._nudged.set()

    def close(self) -> None:
        """Stop polling after a last look."""
        self._ended = True
        self._nudged.set()
        self._thread.join(HANGS_S)

    def _follow(self) -> None:
        while True:
            self._nudged.wait(LOOKS_APART_S)
            self._nudged.clear()
            ended = self._ended
            self._look()
            if ended:
                return

    def _look(self) -> None:
        try:
            show = self.folder.look()
        except InputError as error:
            if str(error) != self._lost:
                self._lost = str(error)
                log.warning("%s", error)
                self._page.say(f"**{error}**")
            return
        except Exception:
            log.exception("the folder could not be read; trying again")
            return
        if self._lost:
            self._lost = ""
            self._page.say("")
        if mark(show) != mark(self._shown):
            self._page.put(self._run, show)
            self._shown = show


def mark(show: Show) -> tuple[object, ...]:
    """Return a key that differs between two looks at a folder if its content has changed."""
    volumes = tuple((name, id(volume)) for name, volume in show.volumes.items())
    poses = tuple((name, len(known)) for name, known in show.poses.items())
    residuals = tuple((name, len(values)) for name, values in show.residuals.items())
    return show.acquired, volumes, poses, residuals, show.state, show.problems


class LivePage:
    """A page that observes a run in this process."""

    def __init__(self, page: Page, out: Path, builder: SimulationBuilder | None = None) -> None:
        """Prepare a page of a run with ``builder``; its folder ``out`` may not exist yet."""
        self._page, self._out, self._builder = page, out, builder
        self._follower: FolderPoller | None = None
        self._shown: Show | None = None
        page.say("planning")

    @property
    def observer(self) -> Observer:
        """Observer for the run, which drops events when the page is too slow."""
        kinds = (PlanMade, JointSample, ViewStored, IterationDone)
        stages = (StageBegan, StageStep, StageEnded, Said)
        return Observer(self.hear, (*kinds, *stages), joints_hz=JOINTS_HZ, waiting=64)

    def hear(self, event: Event) -> None:
        """Put an event on the page; called in the observer's thread."""
        match event:
            case PlanMade(scenario, commanded, plan):
                name = self._out.name
                self._shown = Show(name, scenario, commanded, plan=plan, state="planned")
                fill(self._page, 0, self._shown, self._builder)
            case JointSample():
                self._page.move(0, event.position)
            case ViewStored() | Missed() | StageEnded():
                self._look()
            case IterationDone():
                if self._follower is not None:
                    self._follower.folder.iterated(event)
                self._look()
            case StageBegan(name, total, done) | StageStep(name, total, done):
                if not name.startswith("views"):  # the page shows views as they come
                    self._page.say(f"{name}: {done} of {total}" if total > 1 else name)
            case Said(text, True):
                self._page.say(text)
            case _:
                pass

    def close(self) -> None:
        """Take a last look at the folder of the finished run."""
        self._look()
        self._page.say("the run has finished")
        if self._follower is not None:
            self._follower.close()

    def _look(self) -> None:
        if self._follower is None:
            try:
                folder = RunFolder(self._out, live=True)
                shown = folder.look()
            except InputError:
                return  # nothing is stored yet
            if not shown.poses:
                return
            if self._shown is None:
                fill(self._page, 0, shown, self._builder)
            else:
                self._page.put(0, shown)
            self._shown = shown
            self._follower = FolderPoller(self._page, 0, folder, shown)
        else:
            self._follower.nudge()
