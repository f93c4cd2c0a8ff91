"""Acquisition of a scan, in memory or into a store, and start of the simulations."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError, MissingExtraError
from twinct.core.extras import require
from twinct.geometry.wire import Reached
from twinct.observers import Audience, JointSample, Observers, PlanMade, ViewStored, audience_of
from twinct.runs.checks import check_physics
from twinct.runs.early_end import EarlyEnd
from twinct.scan import (
    LocalRig,
    Rig,
    RigFactory,
    Scan,
    ScanStore,
    SimulationBuilder,
    Stopwatch,
    Sweeps,
    View,
    acquire,
    image_digests,
    local_rig,
    never,
)
from twinct.scenario import Scenario, as_scenario
from twinct.xray import prepare_engine

if TYPE_CHECKING:
    from twinct.link.tap import Heard
    from twinct.xray import Imager
    from twinct.xray.chain import ViewImages

log = logging.getLogger(__name__)

Link = Literal["ros2", "local"]


def installed_link() -> Link:
    """Return ``ros2`` if the extra ``ros`` is installed, else ``local``.

    Raises:
        InputError: the extra is installed, and cannot be imported.
    """
    try:
        require("ros")
    except MissingExtraError:
        return "local"
    return "ros2"


@contextmanager
def rig_factory(
    link: Link,
    engine: str | None,
    logs: Path,
    audience: Audience,
    hear: Callable[[Heard], None] | None = None,
) -> Generator[RigFactory, None, None]:
    """Yield the factory that starts the simulations, after checking that the link works.

    The ROS domain is claimed and announced at once, so that other nodes can join in time. The
    output of the nodes goes to the folder ``logs``; ``hear`` receives all their ROS messages. The
    X-ray engine, by its name in the scenario, is loaded at once if it runs in this process; None
    for a specimen that needs none.

    Raises:
        InputError: the link's extra, the requested ROS domain or the X-ray engine cannot be used.
    """
    if link == "local":
        if engine is not None:
            prepare_engine(engine)
        yield local_rig
        return
    from twinct.link import Domain, require_ros, ros_rigs

    require_ros()
    with closing(Domain()) as domain:
        audience.say(f"ROS 2: other nodes join with ROS_DOMAIN_ID={domain.id}")
        yield ros_rigs(logs, domain, hear)


def scenario_with(
    scenario: Scenario | str | Path, keys: Mapping[str, Any], builder: SimulationBuilder | None
) -> Scenario:
    """Return a scenario, or that of a file, with other values of some keys.

    Raises:
        InputError: a key or its value is wrong; the builder's scenario has other values.
    """
    if keys and builder:
        raise InputError(f"builder: it has its own scenario: change {', '.join(keys)} there")
    return as_scenario(scenario, keys)


@kinds_checked
def simulate(
    scenario: Scenario | str | Path,
    *,
    builder: SimulationBuilder | None = None,
    observers: Observers = (),
    **keys: Any,
) -> Scan:
    """Plan, move and expose every view in this process, without files and without ROS.

    Args:
        scenario: the scenario, or its file.
        builder: provides parts of this scenario that are already built.
        observers: notified of the plan, the moving joints and the views.
        **keys: other values of the scenario's sections, as ``Scenario.with_`` takes them, such as
            ``seed=2``, ``specimen=mesh`` or ``trajectory=geometry``.

    Raises:
        InputError: a file or material of the source or the detector cannot be used.
        TrajectoryError: a view is out of reach or would collide; raised before anything moves.
        MotionError: the arms did not arrive.
    """
    scenario = scenario_with(scenario, keys, builder)
    builder = builder or SimulationBuilder(scenario)
    check_physics(builder)
    images: list[NDArray[np.float32]] = []
    states: list[Reached] = []
    views_to_take = len(builder.targets)
    with (
        audience_of(observers) as audience,
        local_rig(builder, 0, None) as rig,
        audience.stage("views", views_to_take) as step,
    ):
        if audience.wants(JointSample):
            rig.listen(audience.tell)
        audience.tell(PlanMade(scenario, builder.commanded_poses, builder.followed))

        def keep(index: int, image: NDArray[np.float32], reached: Reached) -> None:
            images.append(image)
            states.append(reached)
            audience.tell(ViewStored(index, views_to_take, View(image, reached).frozen()))
            step()

        taken = _HeldScan(builder, images, states)
        end = EarlyEnd(scenario, views_to_take, taken, audience)
        acquire(rig, builder.targets, keep, enough=end.enough)
    return taken.read()


@dataclass
class _HeldScan:
    """A scan that is held in memory."""

    builder: SimulationBuilder
    images: list[NDArray[np.float32]]
    states: list[Reached]
    sweeps: Sweeps = Sweeps()

    def read(self) -> Scan:
        """Return the scan of the views taken."""
        builder, number = self.builder, len(self.images)
        commanded = builder.commanded_poses[:number]
        mas = None if builder.mas is None else builder.mas[:number]
        of_views = commanded, self.images, self.states, mas
        return Scan.from_views(builder.scenario, *of_views, builder.followed)

    def note(self, sweeps: Sweeps) -> None:
        """Keep the comparisons so far."""
        self.sweeps = sweeps


def acquire_to_store(
    builder: SimulationBuilder,
    path: Path,
    make_rig: RigFactory,
    *,
    resume: bool,
    watch: Stopwatch | None = None,
    observers: Observers = (),
) -> ScanStore:
    """Acquire the views that the store lacks; write each one before the next is requested.

    ``watch`` counts the seconds of this call only.

    Raises:
        ScanExistsError: a scan exists and ``resume`` is false, or it belongs to another scenario.
    """
    scenario, targets = builder.scenario, builder.targets
    stored = _StoredScan(builder, path)
    if resume and path.exists():
        stored.store = ScanStore.resume(path, image_digests(scenario))
    missing = stored.store.missing if stored.store else [range(len(targets))]

    def keep(index: int, image: NDArray[np.float32], reached: Reached) -> None:
        frames = None
        if imager is not None:  # no link transmits these images: they are rendered again
            frames = imager.frame(reached.path, index, reached.before)
        stored.write(index, image, reached, frames)
        log.info("view %d: t %.3f s, %s", index, reached.time_s, reached.clearance_in_words)
        view = View(image, reached, frames).frozen()
        audience.tell(ViewStored(index, len(targets), view))
        step()

    with audience_of(observers) as audience:
        end = EarlyEnd(scenario, len(targets), stored, audience)
        for views in missing:  # several ranges only if views were damaged
            state = stored.state_before(views.start)
            with ExitStack() as stack:
                rig = stack.enter_context(closing(make_rig(builder, views.start, state)))
                imager = _imager_of(rig, builder, stack)
                stage = audience.stage("views", len(targets), views.start)
                step = stack.enter_context(stage)
                if audience.wants(JointSample):
                    rig.listen(audience.tell)
                if views is missing[0]:
                    audience.tell(PlanMade(scenario, builder.commanded_poses, builder.followed))
                # Among views that are taken again, none ends the scan.
                enough = end.enough if views.stop == len(targets) else never
                wanted = targets[: views.stop]
                acquire(rig, wanted, keep, first=views.start, watch=watch, enough=enough)
    return stored.complete()


@dataclass
class _StoredScan:
    """A scan that is stored view by view; its first view creates the store."""

    builder: SimulationBuilder
    path: Path
    store: ScanStore | None = None

    def write(
        self, index: int, image: NDArray[np.float32], reached: Reached, frames: ViewImages | None
    ) -> None:
        """Write a view; see ``ScanStore.write``."""
        if self.store is None:
            builder = self.builder
            robots = reached.joint_names, len(reached.state), builder.followed
            self.store = ScanStore.create(
                self.path, builder.scenario, builder.commanded_poses, *robots, mas=builder.mas
            )
        self.store.write(index, image, reached, frames)

    def state_before(self, view: int) -> NDArray[np.float64] | None:
        """Return the state from which a view is taken; None for the plan's home."""
        return self.store.state(view - 1) if self.store and view else None

    def read(self) -> Scan:
        """Return the scan of the views on disk."""
        return self._there.read(unfinished=True)

    @property
    def sweeps(self) -> Sweeps:
        """Comparisons so far."""
        return self._there.sweeps

    def note(self, sweeps: Sweeps) -> None:
        """Store the comparisons so far."""
        self._there.note(sweeps)

    def complete(self) -> ScanStore:
        """Return the store; note that a scan in sweeps is complete with the views on disk."""
        store = self._there
        if self.builder.scenario.until is not None and store.sweeps.complete is None:
            store.note(replace(store.sweeps, complete=store.acquired))
        return store

    @property
    def _there(self) -> ScanStore:
        assert self.store is not None  # a view was taken
        return self.store


def _imager_of(rig: Rig, builder: SimulationBuilder, stack: ExitStack) -> Imager | None:
    """Return the imager that makes the images to keep; the stack closes it. None: none to keep."""
    if not builder.scenario.detector.keep:
        return None
    return rig.imager if isinstance(rig, LocalRig) else stack.enter_context(builder.imager())


def machine_frames(
    scan: Scan, builder: SimulationBuilder, views: Iterable[int]
) -> Iterator[ViewImages]:
    """Yield raw, flat and dark images of views, rendered again from the executed poses.

    A scan stores transmission only, unless ``detector.keep`` requests more. The images are
    bit-identical to those that the transmission was computed from.

    Raises:
        InputError: source and detector are ideal, hence without such images; or lag is combined
            with motion blur, as the scan does not store the pose at the end of an exposure.
    """
    source, detector = scan.scenario.source, scan.scenario.detector
    if source.ideal and detector.ideal:
        raise InputError("an ideal source and detector have no raw images: set detector.readout")
    if detector.lag and scan.simulated.exposure:
        raise InputError(
            "raw images with detector.lag and source.motion_samples cannot be recomputed"
        )
    taken = scan.simulated
    executed = replace(taken.executed, object=taken.executed_object)
    with builder.imager() as imager:
        for view in views:
            path = taken.exposure[view] if taken.exposure else executed[view : view + 1]
            before = executed[view - 1 : view] if detector.lag and view else None
            yield imager.frame(path, view, before)
