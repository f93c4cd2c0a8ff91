"""Work for a study in a worker: acquisition of a scan, or a whole trial."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
import time
from collections.abc import Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from twinct.core.cached import once
from twinct.core.errors import DamagedError, TwinctError
from twinct.core.files.links import look_through, own_folder
from twinct.core.files.private import private_folder
from twinct.evaluation import ImageFigures, region_of_interest
from twinct.observers import Audience
from twinct.recon.volume import Volume
from twinct.report import cross_sections
from twinct.robots.motion import load_plan, save_plan
from twinct.runs import (
    Truth,
    acquire_to_store,
    check_geometries,
    check_physics,
    check_sight,
    judge,
    reconstruct,
    require_extras,
    require_feasible,
    run,
)
from twinct.runs.acquisition import rig_factory
from twinct.runs.known_motion import as_reconstructed, phase_of_truth
from twinct.runs.repeated_figures import repeats_asked
from twinct.runs.repeats import Repeats
from twinct.runs.reporting import figures_of
from twinct.runs.truth import reference_voxels
from twinct.scan import Scan, ScanStore, SimulationBuilder
from twinct.scenario import Scenario, parse_scenario, specimen_digest
from twinct.scenario.reading import key_of
from twinct.specimen import BuiltSpecimen, material
from twinct.specimen.built_file import load_built, save_built
from twinct.study.cache import Cache
from twinct.study.estimate import bytes_below
from twinct.study.sections import packed_sections
from twinct.study.trial_figures import flat_figures
from twinct.workers import Place
from twinct.workers.artifact import remove, save_linked
from twinct.xray.build import effective_energy_kev

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

log = logging.getLogger(__name__)


def scan_name(digest: str) -> str:
    """Return the name under which a shared scan is offered."""
    return f"scan-{digest[:32]}"


@dataclass(frozen=True)
class TrialSpec:
    """A trial in the form sent to a worker.

    Attributes:
        key: digest that identifies the trial.
        scenario: the scenario as plain data.
        files: offered name and path inside the offer of each file, by its key.
        scan: digest of its scan.
        shared: True if other trials use the scan, which is offered under ``scan_name``.
        keep: results that are returned in addition to the figures.
        link: link between the two simulations.
    """

    key: str
    scenario: Mapping[str, Any]
    files: Mapping[str, tuple[str, str]]
    scan: str
    shared: bool
    keep: Literal["figures", "volume", "everything"]
    link: Literal["local", "ros2"]

    @property
    def scan_name(self) -> str:
        """Name under which its scan is offered."""
        return scan_name(self.scan)

    def scenario_at(self, place: Place) -> Scenario:
        """Return the scenario, checked, with the paths of its files at a place of work.

        Raises:
            InputError: it is invalid, or asks for geometries that its scan does not have.
            MissingExtraError: it needs packages that are not installed.
        """
        data = json.loads(json.dumps(self.scenario))
        for key, (name, inner) in self.files.items():
            path = place.fetch(name)
            _set(data, key, str(path / inner if inner else path))
        scenario = parse_scenario(data)
        require_extras(scenario)
        check_geometries(scenario)
        return scenario


@dataclass
class _Seconds:
    """Wall-clock seconds of each stage."""

    stages: dict[str, float] = field(default_factory=dict[str, float])

    @contextmanager
    def stage(self, name: str):
        start = time.perf_counter()
        yield
        self.stages[name] = time.perf_counter() - start


@dataclass(frozen=True)
class _Parts:
    """Specimen and plan of a scenario, from the cache of a place of work.

    Attributes:
        scenario: the scenario.
        cache: the cache.
        seconds: receives the seconds that specimen and plan take.
    """

    scenario: Scenario
    cache: Cache
    seconds: _Seconds

    @cached_property
    def specimen(self) -> BuiltSpecimen:
        digest = specimen_digest(self.scenario)
        with self.seconds.stage("specimen"):
            return once(
                "specimen",
                digest,
                lambda: self.cache.stored(
                    "specimens",
                    digest,
                    self._built,
                    save_built,
                    lambda path: load_built(self.scenario.specimen, path),
                ),
            )

    def _built(self) -> BuiltSpecimen:
        specimen = SimulationBuilder(self.scenario).specimen
        # Cached with the specimen, as many trials need them.
        _ = specimen.hull, specimen.hulls if self.scenario.cell.kind == "arms" else ()
        return specimen

    @cached_property
    def plan(self) -> MotionPlan | None:
        """The motion plan as ``SimulationBuilder`` makes it; None with a gantry."""
        if self.scenario.cell.kind != "arms":
            return None
        builder = self.builder(None)

        def make() -> MotionPlan:
            plan = builder.plan
            assert plan is not None
            return plan

        digest = builder.plan_digest
        with self.seconds.stage("plan"):
            return once(
                "plan",
                digest,
                lambda: self.cache.stored("plans", digest, make, save_plan, load_plan),
            )

    def builder(self, plan: MotionPlan | None) -> SimulationBuilder:
        """Return the builder of the scenario with its specimen and a plan."""
        return SimulationBuilder(self.scenario, plan, self.specimen)


def take_scan(spec: TrialSpec, place: Place) -> dict[str, float]:
    """Acquire a scan that several trials share, and attach its store as ``scan``.

    Returns:
        Seconds of its stages.

    Raises:
        InputError: the scan cannot be acquired.
    """
    parts = _Parts(spec.scenario_at(place), Cache(place.folder), seconds := _Seconds())
    _start(spec, place.folder, seconds)
    builder = parts.builder(parts.plan)
    with seconds.stage("scan"):
        folder = parts.cache.path("scans", spec.scan, lambda draft: _acquire(spec, builder, draft))
    place.attach("scan", folder / "scan.zarr")
    return seconds.stages


def try_trial(spec: TrialSpec, place: Place) -> dict[str, Any]:
    """Acquire, reconstruct and judge one trial.

    Attach ``volume`` if volumes are stored, or ``run``, the run's folder, if everything is stored.

    Returns:
        Figures, their reference material, seconds and ``sections``, a small file of cross-sections.

    Raises:
        InputError: the trial cannot be run.
    """
    cache, seconds = Cache(place.folder), _Seconds()
    _start(spec, place.folder, seconds)
    began = time.perf_counter()
    with cache.locked("trials", spec.key):
        folder = own_folder(place.folder / "trials" / spec.key)
        look_through(folder)
        parts = _Parts(spec.scenario_at(place), cache, seconds)
        shared_scan = _scan_path(spec, place)
        if spec.keep == "everything":
            result = _whole_run(spec, parts, shared_scan, folder, place)
            place.attach("run", folder)
        else:
            result = _figures(spec, parts, shared_scan, folder)
            if spec.keep == "volume":
                place.attach("volume", folder / VOLUME)
    seconds.stages["total"] = time.perf_counter() - began
    return {**result, "seconds": seconds.stages}


VOLUME = "volume.nii"
"""File of a trial's volume in its folder on the node."""

START = "start"
"""Stage in which a worker loads the engines, before its first trial; it belongs to no trial."""

_SMALLEST = {
    "cell": {"kind": "gantry"},
    "trajectory": {"kind": "circle", "views": 2},
    "detector": {"columns": 8, "rows": 8, "pixel_pitch_mm": 40},
    "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 50}}]},
    "reconstruction": {"grid": {"voxels": 8, "voxel_mm": 20}},
}


def _start(spec: TrialSpec, folder: Path, seconds: _Seconds) -> None:
    """Load all engines by a tiny trial, so that the first trial takes as long as the others.

    Over ROS 2, other processes load them with each scan.
    """
    global _started
    if not _started and spec.link == "local":
        _started = True
        smallest, taken = parse_scenario(_SMALLEST), _Seconds()
        here = private_folder(folder)
        with seconds.stage(START), here as passing, suppress(TwinctError):
            first = replace(spec, scan=START, shared=False, keep="figures")
            _figures(first, _Parts(smallest, Cache(passing), taken), None, passing)


_started = False


def _scan_path(spec: TrialSpec, place: Place) -> Path | None:
    """Return the path of the shared scan: this node's own one, or else the offered one."""
    if not spec.shared:
        return None
    taken_here = place.folder / "scans" / spec.scan / "scan.zarr"
    return taken_here if taken_here.exists() else place.fetch(spec.scan_name)


def _acquire(spec: TrialSpec, builder: SimulationBuilder, folder: Path) -> None:
    """Acquire a scan into a folder, or the missing views of an unfinished one."""
    check_physics(builder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "scan.zarr"
    engine = builder.scenario.engine
    with rig_factory(spec.link, engine, folder / "log", Audience()) as make_rig:
        try:
            acquire_to_store(builder, path, make_rig, resume=True)
        except DamagedError as error:
            log.warning("%s; the scan is taken again", error)
            shutil.rmtree(path)
            acquire_to_store(builder, path, make_rig, resume=True)


def _figures(
    spec: TrialSpec, parts: _Parts, shared_scan: Path | None, folder: Path
) -> dict[str, Any]:
    scenario, specimen, seconds = parts.scenario, parts.specimen, parts.seconds
    path = shared_scan or folder / "scan.zarr"
    builder = parts.builder(ScanStore(path).plan if shared_scan else parts.plan)
    require_feasible(scenario, builder.commanded)
    check_sight(builder)
    if shared_scan is None:
        with seconds.stage("scan"):
            _acquire(spec, builder, folder)
    scan = once("scan", spec.scan, lambda: ScanStore(path).read())
    scan = scan.with_settings(scenario)
    with seconds.stage("truth"):
        truth = _truth(scan, specimen, parts.cache)
    images: dict[str, ImageFigures] = {}
    sections, stored = b"", folder / VOLUME
    repeats = Repeats(scan, builder) if repeats_asked(scenario) else None
    for which in scenario.reconstruction.geometries:
        with seconds.stage(f"reconstruction, {which}" if images else "reconstruction"):
            volume = reconstruct(scan, geometry=which, checkpoints=folder / "checkpoints")
        with seconds.stage("judge"):
            again = repeats and repeats.of(which, volume.array)
            images[which] = judge(scan, volume, truth, specimen, again)
        if not sections:
            grid = scenario.reconstruction.volume_grid
            shown = cross_sections(volume.array, truth.volume, truth.region, grid)
            sections = packed_sections(shown, truth.mu_reference)
            if spec.keep == "volume":
                volume.write(stored, "twinct, 1/mm")
    result = {
        "figures": flat_figures(figures_of(scan, images)),
        "reference_material": specimen.reference_name,
        "sections": sections,
    }
    if shared_scan is None:  # for estimates: later trials may share the scan
        result["scan_bytes"] = bytes_below([path])
    attached = stored if spec.keep == "volume" else None
    for used in [path for path in folder.iterdir() if path != attached]:
        remove(used)
    return result


def _whole_run(
    spec: TrialSpec, parts: _Parts, shared_scan: Path | None, folder: Path, place: Place
) -> dict[str, Any]:
    if shared_scan is not None and not (folder / "scan.zarr").exists():
        save_linked(shared_scan, folder / "scan.zarr")
    builder = parts.builder(None if shared_scan else parts.plan)
    scenario = parts.scenario
    finished = run(
        scenario,
        folder,
        link=spec.link,
        resume=True,
        threads=place.threads,
        builder=builder,
    )
    parts.seconds.stages |= finished.figures["seconds"]
    grid, truth = scenario.reconstruction.volume_grid, Volume.read(finished.paths.truth).array
    region = region_of_interest(finished.scan.relative.geometry(scenario.detector.panel), grid)
    shown = cross_sections(finished.volume.array, truth, region, grid)
    return {
        "figures": flat_figures(finished.figures),
        "reference_material": builder.specimen.reference_name,
        "sections": packed_sections(shown, float(truth.max())),
    }


def _truth(scan: Scan, specimen: BuiltSpecimen, cache: Cache) -> Truth:
    """Compute the truth like ``twinct.runs.truth_of``, with the parts that trials share cached."""
    scenario = scan.scenario
    section = scenario.reconstruction.grid
    energy = effective_energy_kev(scenario.source, scenario.detector)
    stands = scan.stands
    at = [*stands.position.tolist(), *stands.quat.tolist()]
    grid = section.model_dump(mode="json")
    bodies = filter(None, (specimen_digest(scenario), phase_of_truth(scenario)))
    of_truth = _digest(["truth", *bodies, energy, at, grid])

    def truth() -> Any:
        return as_reconstructed(specimen, scenario).truth(section.volume_grid, energy, stands)

    executed = scan.relative.geometry(scenario.detector.panel)
    rays = (one.tolist() for one in (executed.source, executed.detector, executed.u, executed.v))
    of_region = _digest(["region", *rays, grid, scenario.detector])

    def region() -> Any:
        return region_of_interest(executed, section.volume_grid)

    def both() -> Truth:
        volume, mu = cache.array(of_truth, truth), specimen.reference_mu(energy)
        return Truth(
            volume,
            cache.array(of_region, region),
            mu,
            section.volume_grid,
            executed,
            mu_water=material("water").mu_per_mm(energy),
            body=reference_voxels(specimen, volume, mu, section.volume_grid, stands),
        )

    return once("truth", f"{of_truth} {of_region}", both)


def _digest(data: Any) -> str:
    text = json.dumps(data, sort_keys=True, default=lambda section: section.model_dump(mode="json"))
    return hashlib.sha256(text.encode()).hexdigest()


def _set(data: Any, dotted: str, value: str) -> None:
    *around, last = key_of(dotted)
    for step in around:
        data = data[step]
    data[last] = value
