"""Acquisition of a scan, in memory or into a store, and start of the simulations."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
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
from twinct.scan import (
    LocalRig,
    RigFactory,
    Scan,
    ScanStore,
    SimulationBuilder,
    Stopwatch,
    View,
    acquire,
    image_digests,
    local_rig,
)
from twinct.scenario import Scenario, as_scenario
from twinct.xray import prepare_engine

if TYPE_CHECKING:
    from twinct.link.tap import Heard
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

        acquire(rig, builder.targets, keep)
    commanded, plan = builder.commanded_poses, builder.followed
    return Scan.from_views(scenario, commanded, images, states, builder.mas, plan)


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
    store = None
    if resume and path.exists():
        store = ScanStore.resume(path, image_digests(scenario))
    missing = store.missing if store else [range(len(targets))]

    def keep(index: int, image: NDArray[np.float32], reached: Reached) -> None:
        nonlocal store
        frames = None
        if imager is not None:  # no link transmits these images: they are rendered again
            frames = imager.frame(reached.path, index, reached.before)
        if store is None:
            robots = reached.joint_names, len(reached.state), builder.followed
            store = ScanStore.create(
                path, scenario, builder.commanded_poses, *robots, mas=builder.mas
            )
        store.write(index, image, reached, frames)
        log.info("view %d: t %.3f s, %s", index, reached.time_s, reached.clearance_in_words)
        view = View(image, reached, frames).frozen()
        audience.tell(ViewStored(index, len(targets), view))
        step()

    with audience_of(observers) as audience:
        for views in missing:  # several ranges only if views were damaged
            state = store.state(views.start - 1) if store and views.start else None
            with ExitStack() as stack:
                rig = stack.enter_context(closing(make_rig(builder, views.start, state)))
                imager = None
                if scenario.detector.keep:
                    local = isinstance(rig, LocalRig)
                    imager = rig.imager if local else stack.enter_context(builder.imager())
                stage = audience.stage("views", len(targets), views.start)
                step = stack.enter_context(stage)
                if audience.wants(JointSample):
                    rig.listen(audience.tell)
                if views is missing[0]:
                    audience.tell(PlanMade(scenario, builder.commanded_poses, builder.followed))
                acquire(rig, targets[: views.stop], keep, first=views.start, watch=watch)
    assert store is not None
    return store


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
