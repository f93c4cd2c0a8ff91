"""Reconstructions of a measured scan, judged without a truth, in a folder each."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.boundary import no_file
from twinct.core.files.lock import sole_owner
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import complete, remove_folder, storage_errors, write_json
from twinct.measured.judgement import Judgement, judge_volume
from twinct.observers import Audience, Observers, audience_of
from twinct.recon.volume import Volume
from twinct.report import (
    MeasuredColumn,
    algorithm_results,
    plain,
    with_results,
    write_measured_report,
)
from twinct.runs import Folder, load_scan, reconstruct
from twinct.runs.folder import as_yaml, refuse_other_keys
from twinct.runs.log import logged_to
from twinct.runs.predicted_and_measured import stored_predictions
from twinct.runs.reconstruction import timed_volume
from twinct.runs.reconstruction_folder import (
    JUDGEMENT,
    check_files,
    file_digest,
    free_name,
    reconstruction_base,
)
from twinct.scan import Scan

log = logging.getLogger(__name__)

FORMAT = "twinct measured volume 1"
VOLUME = "volume.nii"


@dataclass(frozen=True)
class MeasuredVolume:
    """A reconstruction of a measured scan.

    Attributes:
        name: name of its folder.
        in_words: algorithm, settings and results in one line.
        geometry: name of the geometry that it was made from.
        settings: the section ``reconstruction`` that made it, defaults included.
        judgement: figures that need no truth.
        residuals: residual of each iteration.
        seconds: duration of the reconstruction.
        path: its folder; the voxels are in ``volume.nii`` there.
    """

    name: str
    in_words: str
    geometry: str
    settings: Mapping[str, Any]
    judgement: Judgement
    residuals: tuple[float, ...]
    seconds: float
    path: Path = field(compare=False)

    @property
    def volume(self) -> Volume:
        """The volume, 1/mm, read from its file."""
        return Volume.read(self.path / VOLUME)

    @property
    def description(self) -> str:
        """Name, settings and figures in one line."""
        judged = self.judgement
        words = (
            f"{self.name}: {self.in_words}, {self.geometry} geometry; {self.seconds:.1f} s, "
            f"residual {100 * judged.residual_rel:.2f} %, edges {judged.edge_width_mm:.3f} mm wide"
        )
        if np.isfinite(judged.noise_per_mm):
            words += f", noise {judged.noise_per_mm:.5f}/mm"
        if np.isfinite(judged.consistency_rel):
            words += f", consistency {100 * judged.consistency_rel:.2f} %"
        return words

    def write(self, volume: Volume) -> None:
        """Write the folder, which appears only when it is complete."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with complete(self.path) as draft:
            draft.mkdir()
            volume.write(draft / VOLUME, f"twinct {self.in_words}"[:78])
            self.write_figures(draft)

    def write_figures(self, folder: Path | None = None) -> None:
        """Write everything but the voxels, into the folder of the volume."""
        folder = folder or self.path
        data = {"format": FORMAT, **asdict(self), "files": {VOLUME: file_digest(folder / VOLUME)}}
        del data["path"]
        write_json(folder / JUDGEMENT, plain(data))

    @classmethod
    def read(cls, path: Path) -> MeasuredVolume:
        """Read a folder of ``write``, without the voxels.

        Raises:
            InputError: the folder holds no such volume, or is damaged.
        """
        data = read_json(path / JUDGEMENT)
        try:
            if data.pop("format") != FORMAT:
                raise ValueError("another format")
            judged = data.pop("judgement")
            numbers: dict[str, Any] = {k: np.nan if v is None else v for k, v in judged.items()}
            numbers["residual_by_view"] = tuple(judged["residual_by_view"])
            data["residuals"] = tuple(data["residuals"])
            known = {one.name for one in fields(cls)} - {"path", "judgement"}
            named = {key: value for key, value in data.items() if key in known}
            return cls(**named, judgement=Judgement(**numbers), path=path)
        except (TypeError, KeyError, ValueError) as error:
            raise InputError(f"{path / JUDGEMENT}: not a measured volume: {error}") from None


def reconstruct_measured(
    path: str | Path,
    overrides: Iterable[str] = (),
    *,
    geometry: str | None = None,
    name: str | None = None,
    halves: bool = False,
    observers: Observers = (),
) -> MeasuredVolume:
    """Reconstruct a measured scan, judge the volume without a truth, and write the report.

    Args:
        path: folder of ``import_measured``.
        overrides: changes ``reconstruction.KEY=VALUE`` to its scenario.
        geometry: geometry to reconstruct from; None: the scenario's first.
        name: name of the result, below ``reconstructions``; None: after its algorithm.
        halves: also reconstruct the even and the odd views, for the noise; it doubles the time.
        observers: notified of stages and iterations.

    Raises:
        InputError: a key of another section, an unknown geometry, or settings that the algorithm
            refuses.
        ScanExistsError: the name is taken.
    """
    folder, overrides = Folder(Path(path)), tuple(overrides)
    refuse_other_keys(overrides, "reconstruction")
    scan = load_scan(folder.path)
    scenario = folder.scenario_of_run(overrides)
    scan = replace(scan, scenario=scenario)
    which = geometry or scenario.reconstruction.geometries[0]
    scan.poses(which)
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        stack.enter_context(storage_errors(folder.path))
        stack.enter_context(sole_owner(folder.lock))
        base = reconstruction_base(scenario, which)
        name = free_name(name, base, folder.reconstructions)
        stack.enter_context(logged_to(folder.log))
        log.info("measured scan, %s: %s", name, scenario.reconstruction.in_words)
        made, volume = _made(scan, folder, which, name, audience, halves=halves)
        made.write(volume)
        remove_folder(folder.checkpoints)
        with audience.stage("report", 1) as step:
            write_page(scan, folder, measured_volumes(folder.reconstructions))
            step()
    return made


def report_measured(path: str | Path, observers: Observers = ()) -> dict[str, MeasuredVolume]:
    """Judge all volumes of a measured scan again, and rewrite figures and page.

    Figures of two halves of the views stay, as the volumes of the halves are not kept.

    Args:
        path: folder of ``import_measured``.
        observers: notified of the stages.

    Raises:
        InputError: there is no measured scan or no volume in the folder, or one is damaged.
    """
    folder = Folder(Path(path))
    scan, volumes = load_scan(folder.path), measured_volumes(folder.reconstructions)
    if not volumes:
        raise InputError(f"{folder.path} holds no volume yet; 'twinct reconstruct' makes one")
    with (
        sole_owner(folder.lock),
        storage_errors(folder.path),
        audience_of(observers) as audience,
        audience.stage("judge", len(volumes)) as step,
    ):
        integrals = scan.line_integrals()
        for name, one in volumes.items():
            check_files(one.path)
            judged = judge_volume(
                one.volume, scan.geometry(one.geometry), integrals, scan.bad_pixels
            )
            before = one.judgement
            of_halves = {key: getattr(before, key) for key in ("noise_per_mm", "consistency_rel")}
            volumes[name] = replace(one, judgement=replace(judged, **of_halves))
            volumes[name].write_figures()
            step()
        write_page(scan, folder, volumes)
    return volumes


def measured_volumes(folder: Path) -> dict[str, MeasuredVolume]:
    """Return the reconstructions in a folder by name; an absent folder has none."""
    if no_file(folder, folder=True):
        return {}
    paths = sorted(p for p in folder.iterdir() if (p / JUDGEMENT).is_file() and p.name[0] != ".")
    return {path.name: MeasuredVolume.read(path) for path in paths}


def is_measured_scan(path: Path) -> bool:
    """Return True if a folder holds a scan of an unknown specimen."""
    file = Folder(path).scenario
    return file.is_file() and Folder(path).scenario_of_run().specimen.unknown


def _made(
    scan: Scan, folder: Folder, which: str, name: str, audience: Audience, *, halves: bool
) -> tuple[MeasuredVolume, Volume]:
    section = scan.scenario.reconstruction
    volume, residuals, seconds = timed_volume(scan, folder, which, audience)
    parts = None
    if halves:
        first, second = (_half(scan, which, start, audience) for start in (0, 1))
        parts = first, second
    with audience.stage("judge", 1) as step:
        judged = judge_volume(
            volume, scan.geometry(which), scan.line_integrals(), scan.bad_pixels, parts
        )
        step()
    made = MeasuredVolume(
        name=name,
        in_words=with_results(section.in_words, algorithm_results(volume.extras)),
        geometry=which,
        settings=json.loads(section.model_dump_json()),
        judgement=judged,
        residuals=residuals,
        seconds=seconds,
        path=folder.reconstructions / name,
    )
    return made, volume


def _half(scan: Scan, which: str, first: int, audience: Audience) -> Volume:
    """Reconstruct every other view."""
    audience.say(f"{'odd' if first else 'even'} views alone, for the noise")
    part = replace(
        scan,
        transmission=scan.transmission[first::2],
        mas=None if scan.mas is None else scan.mas[first::2],
        derived={},
    )
    return reconstruct(part, geometry=scan.geometry(which)[first::2], observers=audience)


def write_page(scan: Scan, folder: Folder, volumes: Mapping[str, MeasuredVolume]) -> None:
    """Write ``report.html`` and ``metrics.json`` of all volumes of a measured scan."""
    columns = [
        MeasuredColumn(
            name=one.name,
            in_words=f"{one.in_words}, {one.geometry} geometry",
            figures={
                key: value
                for key, value in asdict(one.judgement).items()
                if key != "residual_by_view"
            },
            residual_by_view=one.judgement.residual_by_view,
            residuals=one.residuals,
            seconds=one.seconds,
            volume=one.volume,
        )
        for one in volumes.values()
    ]
    views = np.unique(np.linspace(0, len(scan) - 1, 4).round().astype(int))
    shown = [(int(view), scan.transmission[view]) for view in views]
    geometry = scan.geometry("executed")
    write_measured_report(
        folder.report,
        scan.scenario,
        as_yaml(scan.scenario),
        geometry,
        shown,
        columns,
        stored_predictions(folder.predictions),
    )
    reconstructions = {
        one.name: {
            "in_words": one.in_words,
            "geometry": one.geometry,
            "seconds": one.seconds,
            "judgement": asdict(one.judgement),
        }
        for one in volumes.values()
    }
    write_json(
        folder.metrics,
        plain({"views": len(scan), "truth": None, "reconstructions": reconstructions}),
    )
