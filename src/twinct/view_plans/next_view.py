"""A scan that is chosen view by view, as an environment of Gymnasium.

    env = NextViewEnv("demo", views=20, directions=200)
    observation, info = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

An action is the next direction of the source, from a list or free. The arms of the scenario move
there, or refuse; then the view is taken, and all views so far are reconstructed from the poses that
the system believes. A reward is the improvement of a figure of that volume, less the price of the
view.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError, TargetRefusedError
from twinct.core.extras import require
from twinct.core.foreign_text import quoted
from twinct.core.progress import SILENT
from twinct.evaluation import IMAGE_FIGURES, ImageReference, region_of_interest
from twinct.geometry import Floats, ScanGeometry
from twinct.geometry.wire import PosePairs, Reached, targets_of
from twinct.recon import Projector, sart
from twinct.recon.volume import Volume
from twinct.runs.volumes import Function
from twinct.scan import Scan, SimulationBuilder
from twinct.scenario import Scenario, as_scenario
from twinct.trajectory.orbit import orbit_views
from twinct.view_planning.objectives import Views
from twinct.view_planning.objectives.dose import DOSE
from twinct.view_plans.candidates import candidates_of, orbit_of, reachable
from twinct.view_plans.patient import Patient
from twinct.view_plans.task_goals import region_points
from twinct.xray.build import effective_energy_kev

require("planning")

import gymnasium  # noqa: E402 - after the message about the extra
from gymnasium.spaces import Box, Dict, Discrete, Space  # noqa: E402

if TYPE_CHECKING:
    from twinct.robots.gantry import Gantry
    from twinct.robots.motion import PursuingSimulation
    from twinct.xray import Imager

SHORTEST = 1e-3
"""Shortest vector of an action that still has a direction."""

WORSE = {"lower": 1.0, "higher": -1.0}
"""Factors that make lower values of a figure better."""

AROUND = 24
"""Directions over the whole sphere from which the judged region is seen; more leave it as it is."""

MOST_NUMBER = 2**30
"""Bound of the number of an episode's first view."""


@dataclass(frozen=True)
class Prices:
    """Price of a view, in the unit of the figure.

    Attributes:
        view: price of each view, a refused one included.
        second: price of a second of motion and exposure.
        dose: price of the mean dose of a view to the part that ``task.dose`` names.
    """

    view: float = 0.0
    second: float = 0.0
    dose: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError for a price below 0."""
        for name, value in vars(self).items():
            if not (0 <= value < np.inf):
                raise InputError(f"prices.{name} is {value!r}; it must be 0 or more, and finite")


def five_passes(A: Projector, line_integrals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a volume of five passes of non-negative SART, (z, y, x)."""
    return sart(A, line_integrals, iterations=5, relaxation=0.3, nonnegative=True).array


class NextViewEnv(gymnasium.Env[dict[str, NDArray[np.float32]], Any]):
    """Environment whose actions are the next views of a scan.

    A process has one open environment at a time, as it has one X-ray engine: close it before you
    make another.

    Observations are ``projection``, the line integrals of the last view, (rows, columns);
    ``volume``, the reconstruction so far, (z, y, x), 1/mm; ``direction``, from the isocentre to the
    last source, (3,); and ``left``, the share of the views that are left, (1,). Before the first
    view they are zero, and the share 1.

    The scan ends after a number of views. A direction out of reach, or one that the arms refuse, is
    a step that takes no view; ``info["refused"]`` has the reason. As many of them as there are
    views truncate an episode.

    Attributes:
        directions: unit vectors from the isocentre to the source that a list of actions offers,
            (actions, 3), all within reach; None if actions are free.
        views_of_directions: the commanded views of these actions, likewise.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own

    def __init__(
        self,
        scenario: Scenario | str | Callable[[np.random.Generator], Scenario] = "demo",
        *,
        views: int = 20,
        directions: int | None = 200,
        voxels: int = 32,
        figure: str = "rmse_rel",
        prices: Prices | Mapping[str, float] = Prices(),  # noqa: B008 - frozen
        algorithm: Function = five_passes,
        **keys: Any,
    ) -> None:
        """Build the scenario's simulations.

        Args:
            scenario: the scenario or its name, or a function of a generator that draws one for each
                episode; all of them have one panel, trajectory and cell.
            views: number of views in a scan.
            directions: number of directions over the whole sphere, of which those within reach are
                the actions, ``Discrete``; None: an action is any vector, ``Box`` of (3,), from the
                isocentre towards the source.
            voxels: number of voxels along the longest axis of the volumes.
            figure: ``rmse_rel`` or another of ``IMAGE_FIGURES`` that a volume of zeros has.
            prices: prices of a view.
            algorithm: function of the projector and the line integrals (views, rows, columns) that
                returns the volume (z, y, x); by default five passes of non-negative SART.
            **keys: other values of the scenario's sections.

        Raises:
            InputError: an argument is wrong, the trajectory has no isocentre, no direction is in
                reach, or the scenario has ``uncertainty.views``, errors of numbered views.
        """
        self._prices = prices if isinstance(prices, Prices) else Prices(**prices)
        self._figure = figure
        for name, value, least in (("views", views, 1), ("voxels", voxels, 8)):
            if not (isinstance(value, int) and value >= least):
                raise InputError(
                    f"{name} is {quoted(value)}; it must be a whole number of at least {least}"
                )
        self._views, self._voxels = views, voxels
        self._keys, self._algorithm = keys, algorithm
        self._draw = scenario if callable(scenario) else None
        self._robots: PursuingSimulation | Gantry | None = None
        self._imager: Imager | None = None
        first = scenario(np.random.default_rng(0)) if callable(scenario) else scenario
        self._build(self._coarse(as_scenario(first, keys)))
        self._worse = _direction_of_better(figure, self._reference)
        orbit = orbit_of(self._builder.scenario.trajectory)
        panel = self._builder.scenario.detector.panel
        self.directions: Floats | None = None
        self.views_of_directions: ScanGeometry | None = None
        self.action_space: Space[Any] = Box(-1.0, 1.0, (3,), np.float32)
        if directions is not None:
            candidates = candidates_of(orbit, directions, panel)
            held = reachable(self._builder, candidates, SILENT)
            if not len(held):
                raise InputError(f"none of {directions} directions is within reach of both arms")
            self.views_of_directions = candidates[held]
            away = candidates.source[held] - self._isocentre
            self.directions = away / np.linalg.norm(away, axis=1, keepdims=True)
            self.action_space = Discrete(len(held))
        shape = self._builder.scenario.reconstruction.volume_grid.shape
        self.observation_space: Space[Any] = Dict(
            {
                "projection": Box(-np.inf, np.inf, panel.shape, np.float32),
                "volume": Box(-np.inf, np.inf, shape, np.float32),
                "direction": Box(-1.0, 1.0, (3,), np.float32),
                "left": Box(0.0, 1.0, (1,), np.float32),
            }
        )

    @property
    def scan(self) -> Scan:
        """The views of this episode so far; at least one."""
        if not self._images:
            raise InputError("the episode has no view yet: call step first")
        commanded = PosePairs.joined(self._targets)
        return Scan.from_views(self._builder.scenario, commanded, self._images, self._states)

    @property
    def volume(self) -> Volume:
        """Reconstruction of the views so far, 1/mm; zeros before the first."""
        return self._volume

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
        """Begin an episode: the arms stand where a scan begins, and there is no view.

        The seed draws the scenario, if a function was given, and the noise of the images. Errors of
        the poses follow from the scenario's own seed: a function that draws it varies them.
        """
        super().reset(seed=seed, options=options)
        if self._draw is not None:
            self._build(self._coarse(as_scenario(self._draw(self.np_random), self._keys)))
        elif self._robots is not None:
            self._robots.close()
        if self._imager is None:
            self._imager = self._builder.imager()
        self._robots = self._builder.robots()
        # Views of different episodes have different numbers, which key their noise.
        self._first = int(self.np_random.integers(MOST_NUMBER))
        self._targets: list[PosePairs] = []
        self._images: list[NDArray[np.float32]] = []
        self._states: list[Reached] = []
        self._volume, self._refusals, self._direction = self._nothing, 0, np.zeros(3)
        self._score = self._judged(self._volume)
        return self._observation(), {self._figure: self._score}

    def step(
        self, action: Any
    ) -> tuple[dict[str, NDArray[np.float32]], float, bool, bool, dict[str, Any]]:
        """Take the view of an action, if the arms can.

        Returns:
            Observation, reward, whether all views are taken, whether too many were refused, and
            info: the figure by its name, and ``seconds`` and ``dose`` of the view, or ``refused``.

        Raises:
            InputError: the action is none of ``action_space``, or the episode has not begun.
        """
        if self._robots is None:
            raise InputError("the episode has not begun: call reset first")
        before, price, info = self._score, self._prices.view, dict[str, Any]()
        try:
            view = self._view_of(action)
            seconds, dose = self._take(view), self._dose_of(action, view)
        except TargetRefusedError as refused:
            self._refusals += 1
            info["refused"] = str(refused)
        else:
            info |= {"seconds": seconds, "dose": dose}
            price += self._prices.second * seconds + self._prices.dose * dose
        info[self._figure] = self._score
        reward = self._worse * (before - self._score) - price
        over, lost = len(self._images) >= self._views, self._refusals >= self._views
        return self._observation(), float(reward), over, lost, info

    def close(self) -> None:
        """Release the simulations; ``reset`` opens them again."""
        for one in (self._robots, self._imager):
            if one is not None:
                one.close()
        self._robots = self._imager = None

    def _coarse(self, scenario: Scenario) -> Scenario:
        """Return a scenario with the volumes of the observations."""
        grid = scenario.reconstruction.volume_grid
        edge = float(grid.size_mm.max()) / self._voxels
        section = scenario.reconstruction.grid.model_dump(mode="json")
        section["voxels"] = np.maximum(np.round(grid.size_mm / edge), 2).astype(int).tolist()
        section["voxel_mm"] = edge
        return scenario.with_({"reconstruction.grid": section})

    def _build(self, scenario: Scenario) -> None:
        """Take a scenario, and what does not change with its views."""
        self.close()
        of_views = scenario.uncertainty.views
        if of_views != type(of_views)():
            raise InputError(
                "uncertainty.views: these errors belong to the views of a planned path, and would "
                "not act here; use uncertainty.arms, or leave them out"
            )
        builder = self._builder = SimulationBuilder(scenario)
        grid, stands = scenario.reconstruction.volume_grid, builder.specimen.world_from_specimen
        energy = effective_energy_kev(scenario.source, scenario.detector)
        around = candidates_of(orbit_of(scenario.trajectory), AROUND, scenario.detector.panel)
        truth = builder.specimen.truth(grid, energy, stands)
        self._reference = ImageReference(
            truth,
            region_of_interest(around, grid),
            builder.specimen.reference_mu(energy),
            grid,
        )
        self._nothing = Volume(np.zeros(grid.shape, np.float32), grid)
        self._patient = Patient(builder)
        self._of_directions: Floats | None = None

    def _view_of(self, action: Any) -> ScanGeometry:
        """Return the view of an action.

        Raises:
            InputError: the action is none of ``action_space``.
            TargetRefusedError: the action has no direction.
        """
        if not self.action_space.contains(action):
            raise InputError(f"action {quoted(action)}: it must be in {self.action_space}")
        way = np.asarray(action, np.float64) if self.directions is None else self.directions[action]
        length = float(np.linalg.norm(way))
        if length < SHORTEST:
            raise TargetRefusedError(f"action {quoted(action)} has no direction: it is too short")
        orbit = orbit_of(self._builder.scenario.trajectory)
        source = float(orbit.sod_at(0.5)) * way / length
        one = orbit.model_copy(update={"views": 1})
        return orbit_views(one, self._builder.scenario.detector.panel, source[None])

    def _take(self, view: ScanGeometry) -> float:
        """Take a view, reconstruct, and judge; return the simulated seconds it took."""
        assert self._robots is not None
        assert self._imager is not None
        (target,) = targets_of(view)
        number = self._first + len(self._images)
        begun_s = self._states[-1].time_s if self._states else 0.0
        reached = self._robots.move(None, target)
        image = self._imager.expose(reached.path, number, reached.before, time_s=reached.stamp_s)
        self._targets.append(target)
        self._images.append(image)
        self._states.append(reached)
        scan = self.scan
        A = Projector(scan.geometry("believed"), self._nothing.grid)
        found = np.asarray(self._algorithm(A, scan.line_integrals()), np.float32)
        self._volume = Volume(found, A.grid)
        self._score = self._judged(self._volume)
        beam = reached.executed.source[0].position - self._isocentre
        self._direction = beam / np.linalg.norm(beam)
        return reached.time_s - begun_s

    @property
    def _isocentre(self) -> Floats:
        return np.asarray(orbit_of(self._builder.scenario.trajectory).isocentre_mm)

    def _dose_of(self, action: Any, view: ScanGeometry) -> float:
        """Return the dose of a view to the part of ``task.dose``; 0 without it."""
        if self.views_of_directions is None:
            return float(self._doses(view)[0])
        if self._of_directions is None:  # once for all actions
            self._of_directions = self._doses(self.views_of_directions)
        return float(self._of_directions[action])

    def _doses(self, views: ScanGeometry) -> Floats:
        """Return the dose of each view, (views,)."""
        numbers, task = range(len(views)), self._builder.scenario.task
        if task is None or DOSE.name not in task.goals:
            return np.zeros(len(views))
        objective, section = task.goals[DOSE.name]
        points = region_points(task, self._builder.specimen.world_from_specimen)
        measured = objective.measure(section, Views(views, [0], points), self._patient)
        measure = measured[0] if isinstance(measured, tuple) else measured
        return measure.added([], numbers)

    def _judged(self, volume: Volume) -> float:
        """Return the figure of a volume."""
        return float(self._reference.figures(volume.array).as_dict()[self._figure])

    def _observation(self) -> dict[str, NDArray[np.float32]]:
        panel = self._builder.scenario.detector.panel
        projection = np.zeros(panel.shape, np.float32)
        if self._images:
            projection = self.scan.of_views([len(self._images) - 1]).line_integrals()[0]
        left = 1 - len(self._images) / self._views
        return {
            "projection": projection,
            "volume": self._volume.array.astype(np.float32),
            "direction": self._direction.astype(np.float32),
            "left": np.array([left], np.float32),
        }


def _direction_of_better(name: str, reference: ImageReference) -> float:
    """Return 1 if lower values of a figure of volumes are better, or -1.

    Raises:
        InputError: there is no such figure.
    """
    of_volumes = reference.figures(np.zeros(reference.grid.shape, np.float32)).zero
    known = {one.key: WORSE[one.best] for one in IMAGE_FIGURES if one.key in of_volumes}
    if name not in known:
        raise InputError(f"figure is {quoted(name)}; it must be one of {', '.join(known)}")
    return known[name]
