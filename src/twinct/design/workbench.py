"""The model of the workbench: a draft, the answers about it, and the prices of its changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.threads import available_threads
from twinct.design.desk import Answer, Desk, State
from twinct.design.doses import PathDose, dose_is_known
from twinct.design.draft import Draft
from twinct.design.edits import Edit
from twinct.design.questions import (
    HeldViews,
    PlannedMotion,
    Projection,
    Question,
    ScanCosts,
    ShadedSphere,
    Shading,
)
from twinct.design.reasons import WhyDead
from twinct.design.scattered import Scatter
from twinct.design.seen import SeenShare
from twinct.design.whole_run import WholeRun, folder_of
from twinct.runs.acquisition import Link
from twinct.scenario import Scenario

FINEST_DIRECTIONS = 800
"""Directions at which the shading of the sphere ends."""

OF_IMAGES = ("image", "costs", "seen")
"""Subjects of the desk for images."""

OF_SCATTER = ("scatter",)
"""Subject of the desk for the scatter in previews, for which no image waits."""

OF_REACH = ("views", "sphere", "reason")
"""Subjects of the desk for reach, which waits neither for images nor for a motion plan."""

ON_REQUEST = ("volume", "check", "time", "proposal", "upload", "dose")
"""Subjects of the desk for longer work, which neither images nor reach wait for."""


@dataclass(frozen=True)
class Price:
    """A quantity that a design costs.

    Attributes:
        name: name for users.
        unit: its unit.
        now: value of the present state, or of the last one that has an answer; NaN without any.
        saved: value of the last saved state; NaN if it is not known.
        state: state of ``now``.
        why: why there is no value; empty if there is one, or none was asked for.
    """

    name: str
    unit: str
    now: float
    saved: float
    state: State
    why: str = ""

    @property
    def change(self) -> float:
        """Present value minus the saved one; NaN if one is not known."""
        return self.now - self.saved


_PRICES: tuple[tuple[str, str, str, Callable[[Any], float]], ...] = (
    ("motion", "motion time", "s", lambda value: value.duration_s),
    ("motion", "smallest clearance", "mm", lambda value: value.clearance_mm),
    ("views", "views within reach", "", lambda value: float(value.sum())),
    ("costs", "views", "", lambda value: value.views),
    ("costs", "exposure", "s", lambda value: value.exposure_s),
    ("costs", "reconstruction time", "s", lambda value: value.reconstruction_s),
    ("costs", "reconstruction memory", "GB", lambda value: value.reconstruction_bytes / 1e9),
    ("costs", "largest memory of the run", "GB", lambda value: value.memory_bytes / 1e9),
    ("costs", "disk space of the run", "MB", lambda value: value.disk_bytes / 1e6),
    ("seen", "specimen in every view", "%", lambda value: 100 * value.by_all),
    ("dose", "mean dose", "mGy", lambda value: 1000 * value.mean_gy),
    ("dose", "kerma-area product", "Gy cm2", lambda value: value.kerma_area_product_gy_cm2),
)
"""Subject, name, unit and value of each price."""

OF_DOSE = tuple(name for subject, name, _, _ in _PRICES if subject == "dose")


class Workbench:
    """A draft with answers that follow it.

    After each change, only the questions whose answers may differ are asked again; their last
    answers stay meanwhile.

    Attributes:
        draft: the draft.
        view: index of the view of the image.
        started: the newest run; None before the first one.
        shelf: folder of specimens, each built once for all processes.
    """

    def __init__(
        self, draft: Draft, folder: Path, told: Callable[[str, Answer], object] = lambda *_: None
    ) -> None:
        """Prepare a workbench; ``begin`` asks the first questions.

        Args:
            draft: the draft.
            folder: folder for the output of the workers.
            told: called with subject and answer after each change, in any thread.
        """
        self.draft, self.view = draft, 0
        self.started: WholeRun | None = None
        self._why: WhyDead | None = None
        self._scattered: Scatter | None = None
        self._told = told
        self._asked: dict[str, object] = {}
        self._at_saved: dict[str, Any] = {}
        self.shelf = folder / "specimens"
        every = available_threads()
        half = max(every // 2, 1)
        self._images, self._scatter, self._reach, self._motions, self._longer, self._runs = (
            Desk(folder / name, self._hear, threads=number, shelf=self.shelf)
            for name, number in (
                *(("images", half), ("scatter", half), ("reach", half), ("motions", half)),
                *(("longer", half), ("runs", every)),
            )
        )

    def begin(self) -> None:
        """Ask the first questions."""
        self._ask_anew()

    def close(self) -> None:
        """End all workers, a run too, which keeps its views; the draft stays on disk."""
        for desk in self._desks:
            desk.close()

    def set(self, values: Mapping[str, Any], *, gesture: object = None) -> None:
        """Set keys, as one edit; see ``Draft.set``."""
        self.draft.set(values, gesture=gesture)
        self._ask_anew()

    def apply(self, edit: Edit) -> None:
        """Apply an edit; see ``Draft.apply``."""
        self.draft.apply(edit)
        self._ask_anew()

    def undo(self) -> None:
        """Return to the state before the last edit."""
        self.draft.undo()
        self._ask_anew()

    def redo(self) -> None:
        """Repeat the edit that was undone last."""
        self.draft.redo()
        self._ask_anew()

    def save(self, *, over: bool = False) -> None:
        """Write the file; see ``Draft.save``."""
        self.draft.save(over=over)
        self._at_saved.clear()
        for subject in self._asked:
            self._note_saved(self.answer(subject))

    def take_over(self) -> None:
        """Take over the file of another program; see ``Draft.take_over``."""
        self.draft.take_over()
        self._at_saved.clear()
        self._ask_anew()

    def look(self, view: int, *, whole: bool = False) -> None:
        """Ask for the image of a view: few pixels, or all of them with noise and scatter."""
        self.view = view
        if not self.draft.problems:
            self._images.ask(Projection(self.draft.source, view, whole))

    def ask_for_scatter(self) -> None:
        """Ask for the scatter in the preview that is shown, if the scenario has scatter."""
        image = self.answer("image")
        shown, scenario = image.question, self.draft.scenario
        if scenario is None or scenario.detector.scatter is None or self.draft.problems:
            return
        if image.state is State.FRESH and isinstance(shown, Projection) and not shown.whole:
            question = Scatter(shown.source, shown.view)
            if self._scattered != question or self.answer("scatter").state is State.OLD:
                self._scattered = question
                self._scatter.ask(question)

    def scatter_in(self, shown: Question | None) -> Answer:
        """Return the scatter in a preview; its value is None unless it is that of this preview."""
        if not isinstance(shown, Projection) or shown.whole:
            return Answer()
        answer, asked = self.answer("scatter"), Scatter(shown.source, shown.view)
        if self._scattered != asked:
            return Answer()
        return answer if answer.question == asked else replace(answer, value=None)

    def ask(self, question: Question) -> None:
        """Ask a question that is only asked on request, such as for a small volume."""
        if (scenario := self.draft.scenario) is not None:
            self._asked[question.subject] = question.reads(scenario)
        self._desk_of(question.subject).ask(question)

    def ask_for_costs(self) -> None:
        """Ask for the costs of a run again, as its time has become known."""
        if not self.draft.problems:
            self._images.ask(ScanCosts(self.draft.source))

    def cancel(self) -> None:
        """Stop the calculations of scatter, reach, motions, volumes, proposals; a run goes on."""
        for desk in (self._scatter, self._reach, self._motions, self._longer):
            desk.cancel()

    def rest(self) -> None:
        """Ask what is only worth its time when nothing has changed for a while."""
        if self.draft.scenario is not None and not self.draft.problems:
            self.look(self.view, whole=True)
            if dose_is_known(self.draft.scenario):
                self._ask_if_changed(PathDose(self.draft.source), self.draft.scenario)

    def explain(self) -> None:
        """Ask why the arms cannot take the view of the image, if they cannot."""
        held = self.answer("views")
        if held.state is not State.FRESH or self.view >= len(held.value) or held.value[self.view]:
            return
        question = WhyDead(self.draft.source, self.view)
        known = self.answer("reason")
        if self._why != question or known.state is State.OLD:
            self._why = question
            self._reach.ask(question)

    def accept(self) -> None:
        """Make the proposal's edit, as one step that can be undone.

        Raises:
            InputError: there is no proposal for the present state.
        """
        proposal = self.answer("proposal")
        if proposal.state is not State.FRESH:
            raise InputError(f"the proposal is {proposal.state}: ask for one of the present state")
        self.apply(proposal.value.edit)

    def run(self, link: Link | None = None) -> None:
        """Start the whole run of the present state, unless one works.

        Args:
            link: as of ``twinct.run``.

        Raises:
            InputError: a run works already, or the draft has problems.
        """
        scenario = self.draft.scenario
        if scenario is None or self.draft.problems:
            raise InputError(self.draft.problems or "there is no scenario")
        if self.answer("run").state is State.COMPUTING:
            raise InputError("a run works already: cancel it, or wait for its end")
        self.started = WholeRun(self.draft.source, folder_of(self.draft.path, scenario), link)
        self._runs.ask(self.started)

    def cancel_run(self) -> None:
        """Stop the run; it keeps its views, and goes on with them when it is started again."""
        self._runs.cancel()

    @property
    def shows_run(self) -> bool:
        """True if the newest run is one of the present state."""
        return self.started is not None and self.started.source == self.draft.source

    def answer(self, subject: str) -> Answer:
        """Return the answer of a subject."""
        return self._desk_of(subject).answer(subject)

    def prices(self) -> list[Price]:
        """Return what the present state costs, and what the saved one costs."""
        prices, told = list[Price](), set[str]()
        for subject, name, unit, value in _PRICES:
            answer, saved = self.answer(subject), self._at_saved.get(subject)
            now = math.nan if answer.value is None else float(value(answer.value))
            before = math.nan if saved is None else float(value(saved))
            why = "; ".join(answer.problems) if answer.state is State.FAILED else ""
            if not why and math.isnan(now):
                why = self._why_unknown(name)
            # A long reason is said once: several prices may have it.
            prices.append(
                Price(name, unit, now, before, answer.state, "see above" if why in told else why)
            )
            told |= {why} - {""}
        return prices

    def _why_unknown(self, price: str) -> str:
        """Return what a price without a value needs; empty if its value may still come."""
        scenario = self.draft.scenario
        if self.answer("costs").state is State.FRESH and price == "reconstruction time":
            return "press 'measure time'"
        if scenario is not None and price in OF_DOSE and not dose_is_known(scenario):
            return "needs a tube, or source.photons_per_mm2_mas"
        return ""

    def settle(self, timeout_s: float | None = None) -> bool:
        """Wait until all questions are answered; return False on timeout."""
        return all(desk.settle(timeout_s) for desk in self._desks)

    @property
    def _desks(self) -> tuple[Desk, ...]:
        of_scan = self._images, self._scatter, self._reach, self._motions
        return *of_scan, self._longer, self._runs

    def _desk_of(self, subject: str) -> Desk:
        if subject in OF_IMAGES:
            return self._images
        if subject in OF_SCATTER:
            return self._scatter
        if subject in OF_REACH:
            return self._reach
        if subject in ON_REQUEST:
            return self._longer
        return self._runs if subject == WholeRun.subject else self._motions

    def _ask_anew(self) -> None:
        """Ask the questions whose answers may have changed; the others on request become old."""
        scenario, source = self.draft.scenario, self.draft.source
        usual: tuple[Question, ...] = (
            Projection(source, self.view),
            ScanCosts(source),
            HeldViews(source),
            ShadedSphere(source),
            PlannedMotion(source),
            SeenShare(source),
        )
        if scenario is None or self.draft.problems:
            for subject in self._asked:
                self._desk_of(subject).outdate(subject)
            self._asked.clear()
            return
        for question in usual:
            self._ask_if_changed(question, scenario)
        of_path = PathDose(source)
        if self._asked.get(of_path.subject) == of_path.reads(scenario):
            usual = (*usual, of_path)
        for subject in set(self._asked) - {question.subject for question in usual}:
            del self._asked[subject]
            self._desk_of(subject).outdate(subject)
        if self._why is not None and self._why.source != source:
            self._reach.outdate(WhyDead.subject)

    def _ask_if_changed(self, question: Question, scenario: Scenario) -> None:
        reads = question.reads(scenario)
        if self._asked.get(question.subject) != reads:
            self._asked[question.subject] = reads
            self._desk_of(question.subject).ask(question)

    def _hear(self, subject: str, answer: Answer) -> None:
        if answer.state is State.FRESH:
            self._note_saved(answer)
        self._told(subject, answer)

    def _note_saved(self, answer: Answer) -> None:
        """Note an answer about the saved state."""
        question = answer.question
        if answer.state is State.FRESH and question is not None:
            scenario = self.draft.scenario
            if self.draft.is_saved and scenario is not None:
                self._at_saved[question.subject] = answer.value

    def refine(self) -> None:
        """Ask for more directions of the sphere, if its shading is fresh and coarse."""
        answer = self.answer("sphere")
        shading: Shading | None = answer.value
        if answer.state is not State.FRESH or shading is None or self.draft.problems:
            return
        if len(shading.directions) < FINEST_DIRECTIONS:
            self._reach.ask(ShadedSphere(self.draft.source, known=shading))
