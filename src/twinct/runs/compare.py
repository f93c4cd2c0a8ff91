"""Comparison of finished runs and of their further reconstructions."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.foreign_text import counted
from twinct.evaluation import region_of_interest
from twinct.geometry import Pose, VolumeGrid
from twinct.observers import Observers, audience_of
from twinct.recon.volume import Volume
from twinct.report import Compared, Comparison, CrossSection, plain, with_results
from twinct.report.same_planes import AxisPlane, layer_of, planes_through, section_at
from twinct.runs.folder import Folder
from twinct.runs.job import Run, finished_run
from twinct.runs.known_motion import as_reconstructed, phase_of_truth
from twinct.runs.reconstruction_folder import (
    StoredReconstruction,
    check_files,
    stored_reconstructions,
)
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scenario import SECTIONS, Scenario, specimen_digest
from twinct.specimen import BuiltSpecimen
from twinct.version import __version__
from twinct.xray.build import effective_energy_kev


@kinds_checked
def compare(folders: Iterable[str | Path], observers: Observers = ()) -> Comparison:
    """Compare volumes with the first one: of finished runs, or of imported scans.

    All slices show the same planes in the world. Grids and specimens may differ; the ``notes`` then
    list the values that cannot be compared.

    Args:
        folders: two or more runs or further reconstructions, ``RUN/reconstructions/NAME``; or
            imported scans, of which all volumes count, and single volumes of them.
        observers: notified of the stage.

    Raises:
        InputError: folders without a finished run or listed twice, each with its name; or fewer
            than two folders; or volumes with and without a truth.
    """
    paths = [Path(folder) for folder in folders]
    if any(_has_no_truth(path) for path in paths):
        return _without_truth(paths, observers)
    entries = _entries(paths)
    labels = _labels(entries)
    specimens: dict[str, BuiltSpecimen] = {}
    planes: dict[str, AxisPlane] = {}
    compared: list[Compared] = []
    with audience_of(observers) as audience, audience.stage("slices", len(entries)) as step:
        for entry, label in zip(entries, labels, strict=True):
            bodies = specimen_digest(entry.scenario)
            if bodies not in specimens:
                specimens[bodies] = SimulationBuilder(entry.scenario).specimen
            truth = bodies + phase_of_truth(entry.scenario)
            compared.append(_compared(entry, label, specimens[bodies], planes, truth))
            step()
    return Comparison(tuple(compared))


def _scan_folder(path: Path) -> Folder:
    """Return the folder of the scan that a folder of a scan or of a volume belongs to."""
    whole = path.resolve()
    return Folder(whole.parents[1] if whole.parent.name == "reconstructions" else path)


def _has_no_truth(path: Path) -> bool:
    folder = _scan_folder(path)
    return folder.scenario.is_file() and folder.settings_of_scan().specimen is None


def _without_truth(paths: Sequence[Path], observers: Observers) -> Comparison:
    """Compare volumes of imported scans."""
    volumes: list[tuple[Folder, StoredReconstruction]] = []
    for path in paths:
        volumes += _volumes(path)
    places = [one.path.resolve() for _, one in volumes]
    if len(set(places)) < len(places):
        raise InputError("a volume is given twice; each is compared once")
    if len(volumes) < 2:
        raise InputError(f"{counted(len(volumes), 'volume')}: at least two are needed")
    scans = [folder.path.resolve() for folder, _ in volumes]
    common = Path(os.path.commonpath([scan.parent for scan in scans]))
    planes: dict[str, AxisPlane] = {}
    compared: list[Compared] = []
    with audience_of(observers) as audience, audience.stage("slices", len(volumes)) as step:
        for (folder, one), scan in zip(volumes, scans, strict=True):
            label = one.name if len(set(scans)) == 1 else f"{scan.relative_to(common)}:{one.name}"
            compared.append(_compared_without_truth(folder, one, label, planes))
            step()
    return Comparison(tuple(compared))


def _volumes(path: Path) -> list[tuple[Folder, StoredReconstruction]]:
    folder = _scan_folder(path)
    if not _has_no_truth(path):
        raise InputError(
            f"{path} is not a measured scan, so it cannot be compared with one; a simulated run is "
            "judged by its truth"
        )
    if folder.path is not path and path.is_dir():
        check_files(path)
        return [(folder, StoredReconstruction.read(path))]
    volumes = stored_reconstructions(folder.reconstructions) if folder.path is path else {}
    if not volumes:
        raise InputError(f"{path} holds no volume yet; 'twinct reconstruct' makes one")
    return [(folder, one) for one in volumes.values()]


def _compared_without_truth(
    folder: Folder, one: StoredReconstruction, label: str, planes: dict[str, AxisPlane]
) -> Compared:
    """Cut a volume along the planes; choose those through the middle if there are none yet."""
    store = ScanStore(folder.scan)
    section = SECTIONS[str(one.settings["algorithm"])].model_validate(dict(one.settings))
    section = section.model_copy(update={"geometry": one.geometry})
    settings = folder.settings_of_scan().model_copy(update={"reconstruction": section})
    volume = one.volume
    if not planes:
        half = volume.grid.size_mm / 2
        middle: Pose = volume.grid.world_from_grid
        planes |= planes_through(volume.grid, np.stack([-half, half]), middle, lambda _: True)
    slices: dict[str, CrossSection | None] = {}
    for name, plane in planes.items():
        layer = layer_of(plane, volume.grid)
        slices[name] = layer and section_at(
            plane, volume.array, volume.grid, layer, None, np.ones(layer.shape, bool)
        )
    figures = plain(one.figures.as_dict())
    del figures["residual_by_view"]
    images = store.digests["images"]
    return Compared(
        label=label,
        path=str(one.path),
        scenario=settings,
        metrics={
            "views": store.views,
            "reached": store.views,
            "twinct_version": __version__,
            "scenario_digest": images,
        },
        image=figures,
        in_words=one.description,
        seconds={"reconstruction": one.seconds},
        slices=slices,
        mu_reference=float("nan"),
        reference="",
        truth=images,
    )


@dataclass(frozen=True)
class _Entry:
    """Content of one folder, with the scenario of its reconstruction."""

    path: Path
    run: Run
    scenario: Scenario
    reconstruction: StoredReconstruction | None = None

    def volume(self) -> Volume:
        """Read the volume; it is not cached, as the volumes of all runs may exceed the memory."""
        return (
            self.reconstruction.volume
            if self.reconstruction
            else Volume.read(self.run.paths.volume)
        )


def _entries(paths: Sequence[Path]) -> list[_Entry]:
    """Read and check all folders, without their images.

    Raises:
        InputError: one sentence for each folder that cannot be compared.
    """
    entries: dict[Path, _Entry] = {}
    problems: list[str] = []
    for path in paths:
        try:
            if path.resolve() in entries:
                raise InputError(f"{path}: given twice; each folder is compared once")
            entries[path.resolve()] = _entry(path)
        except InputError as error:
            problems += error.problems
    if len(paths) < 2:
        problems += [f"{counted(len(paths), 'folder')}: at least two are needed{_advice(paths)}"]
    if problems:
        raise InputError(problems)
    return list(entries.values())


def _advice(paths: Sequence[Path]) -> str:
    beside = sorted(
        str(path_beside) for path in paths for path_beside in path.glob("reconstructions/[!.]*")
    )
    return f"; its reconstructions are {', '.join(beside)}" if beside else ""


def _entry(path: Path) -> _Entry:
    reconstruction = None
    folder = path.resolve()
    if folder.parent.name == "reconstructions":
        check_files(path)
        reconstruction, folder = StoredReconstruction.read(path), folder.parents[1]
    run = finished_run(Folder(folder if reconstruction else path))
    run = Run(run.scenario, run.paths)  # drops the volume that finished_run has read
    _ = run.figures  # reports unreadable figures now
    if reconstruction is None:
        return _Entry(path, run, run.scenario)
    section = SECTIONS[str(reconstruction.settings["algorithm"])].model_validate(
        dict(reconstruction.settings)
    )
    return _Entry(
        path, run, run.scenario.model_copy(update={"reconstruction": section}), reconstruction
    )


def _labels(entries: Sequence[_Entry]) -> list[str]:
    """Return the distinctive part of each path."""
    runs = [entry.run.paths.path.resolve() for entry in entries]
    common = Path(os.path.commonpath([path.parent for path in runs]))
    return [
        str(path.relative_to(common))
        + (f":{entry.reconstruction.name}" if entry.reconstruction else "")
        for path, entry in zip(runs, entries, strict=True)
    ]


def _compared(
    entry: _Entry, label: str, specimen: BuiltSpecimen, planes: dict[str, AxisPlane], truth: str
) -> Compared:
    """Cut a volume along the planes; choose the planes if there are none yet."""
    scenario, run, reconstruction = entry.scenario, entry.run, entry.reconstruction
    energy = effective_energy_kev(scenario.source, scenario.detector)
    scan, grid = run.scan, scenario.reconstruction.volume_grid
    stands = scan.stands
    specimen = as_reconstructed(specimen, scenario)
    if not planes:

        def hit(layer: VolumeGrid) -> bool:
            return bool(specimen.truth(layer, energy, stands).any())

        planes |= planes_through(grid, specimen.bounds, stands, hit)
    volume, views = entry.volume(), scan.relative.geometry(scenario.detector.panel)
    slices: dict[str, CrossSection | None] = {}
    for name, plane in planes.items():
        layer = layer_of(plane, grid)
        slices[name] = layer and section_at(
            plane,
            volume.array,
            grid,
            layer,
            specimen.truth(layer, energy, stands),
            region_of_interest(views, layer),
        )
    metrics = run.figures
    return Compared(
        label=label,
        path=str(entry.path),
        scenario=scenario,
        metrics=metrics,
        image=plain(reconstruction.figures.as_dict()) if reconstruction else metrics["image"],
        in_words=reconstruction.description
        if reconstruction
        else with_results(scenario.reconstruction.in_words, metrics),
        seconds={"reconstruction": reconstruction.seconds}
        if reconstruction
        else metrics["seconds"],
        slices=slices,
        mu_reference=specimen.reference_mu(energy),
        reference=specimen.reference_name,
        truth=truth,
    )
