"""Folder of a run: paths of its files, and checks before anything is written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.folder_paths import Below, names_below
from twinct.core.files.plain_json import read_json
from twinct.core.files.plain_yaml import read_file, written
from twinct.core.files.writing import check_folder, write_text
from twinct.link.recording import recordings
from twinct.report.earlier_names import with_todays_names
from twinct.runs.reconstruction_folder import file_digest
from twinct.scan import OWN, named_geometries, scenario_in
from twinct.scenario import Scenario, load_scenario, stage_digests, with_paths
from twinct.scenario.imported import ScanSettings, is_imported, load_imported


@dataclass(frozen=True)
class Folder:
    """Paths of all files of a run, below its ``--out``.

    Attributes:
        path: the folder itself.
        scan: the scan store.
        volume: the reconstruction.
        truth: the true volume, on the grid of the reconstruction.
        metrics: the figures.
        report: the report.
        geometries: geometries derived from the scan, a file each.
        arms: both arms, as calibrated by a phantom's scan.
        reconstructions: further reconstructions of the scan, a folder each.
        predictions: predicted views beside the measured ones, a folder each.
        checkpoints: checkpoints of unfinished reconstructions.
        scenario: the scenario as it was run, defaults included.
        inputs: meshes and views that the scenario took from a program's memory.
        views: views of a scan that was imported from another tool's recording.
        drive: times of a plan that real arms followed, and of their images.
        imported: picture of a measured scan that was imported.
        tried: picture of a measured scan with several conventions.
        seconds: timing of an unfinished run.
        logs: output of the nodes of the ROS 2 link.
        log: the log of the run.
        lock: held by the process that works in the folder.
    """

    path: Path
    scan = Below("scan.zarr")
    volume = Below("volume.nii")
    truth = Below("truth.nii")
    metrics = Below("metrics.json")
    report = Below("report.html")
    geometries = Below("geometries")
    arms = Below("arms.json")
    reconstructions = Below("reconstructions")
    predictions = Below("predictions")
    checkpoints = Below("checkpoints")
    scenario = Below("scenario.yaml")
    inputs = Below("inputs")
    views = Below("views.csv")
    drive = Below("drive.json")
    imported = Below("imported.png")
    tried = Below("tried.png")
    seconds = Below("seconds.json")
    logs = Below("log")
    log = Below("twinct.log")
    lock = Below("twinct.lock")

    def __post_init__(self) -> None:
        """Check that the path is no pipe or device.

        Raises:
            InputError: it is one.
        """
        if (why := no_file(self.path, folder=True)) and why != ABSENT:
            raise InputError(f"{self.path} {why}")

    @property
    def results(self) -> tuple[Path, ...]:
        """Files that a finished run always has."""
        return self.scan, self.volume, self.metrics, self.report

    def settings_of_scan(
        self, overrides: tuple[str, ...] = (), changes: Mapping[str, Any] | None = None
    ) -> ScanSettings:
        """Return the settings of the scan, with some keys changed: its scenario, if it has one.

        Args:
            overrides: texts ``KEY=VALUE``.
            changes: further values by dotted key.
        """
        if is_imported(self.stated()):
            return load_imported(self.scenario, overrides, changes)
        scenario = self.scenario_of_run(overrides)
        return scenario.with_(changes) if changes else scenario

    def scenario_of_run(self, overrides: tuple[str, ...] = ()) -> Scenario:
        """Return the scenario that the run was made with, with some keys changed.

        Scenarios of early versions do not state the scheme of motion, which was ``reactive`` then.

        Raises:
            InputError: the scan was imported, and has no scenario.
        """
        if is_imported(stated := self.stated()):
            return scenario_in(load_imported(self.scenario))
        motion = stated.get("motion")
        early = isinstance(motion, dict) and "scheme" not in motion
        scheme = ("motion.scheme=reactive",) if early else ()
        return load_scenario(self.scenario, (*scheme, *overrides), resolved=True)

    def write_scenario(self, settings: ScanSettings) -> None:
        """Write a scan's settings, which name files below ``inputs`` relative to this folder."""

        def relative(path: Path) -> Path:
            inside = path.parent == self.inputs.resolve()
            return path.relative_to(self.path.resolve()) if inside else path

        data = with_paths(json.loads(settings.resolved()), relative)
        write_text(self.scenario, written(data))

    def file_digests(self) -> dict[str, str]:
        """Return the digests of the files with the volume and its truth, by name."""
        files = (self.volume, self.truth)
        return {path.name: file_digest(path) for path in files if path.is_file()}

    def replaced(self, *files: Path) -> tuple[str, ...]:
        """Return a sentence for each file that is missing or not the one that was judged.

        Without ``files``, the volume and its truth are looked at. Figures of earlier versions hold
        no digests; then there is no sentence.
        """
        judged: dict[str, Any] = read_metrics(self.metrics).get("files") or {}
        there = self.file_digests()
        names = [path.name for path in files or (self.volume, self.truth)]
        changed = [name for name in names if name in judged and judged[name] != there.get(name)]
        return tuple(
            f"{self.path / name} {'was changed or replaced' if name in there else 'is missing'}: "
            f"it is not the file that {self.metrics.name} belongs to"
            for name in changed
        )

    def stated(self) -> dict[str, Any]:
        """Return what the scenario's file states, unchecked."""
        stated = read_file(self.scenario, "scenario").value
        return cast("dict[str, Any]", stated) if isinstance(stated, dict) else {}

    def volume_digest(self, scenario: Scenario) -> str:
        """Return the digest of all inputs of the volume, derived geometries included."""
        digest = stage_digests(scenario)["volume"]
        derived = [name for name in scenario.reconstruction.geometries if name not in OWN]
        if derived:
            there = named_geometries(self.geometries)
            digest += "".join(there[name].digest for name in derived if name in there)
            digest = hashlib.sha256(digest.encode()).hexdigest()
        return digest

    def refuse_others(self) -> None:
        """Raise if the folder holds anything that is not part of a run."""
        recorded = (path.name for path in recordings(self.path))
        exports = (path.name for path in self.path.glob("export-*"))
        check_folder(self.path, {*names_below(Folder), *recorded, *exports})

    def refuse_if_taken(self, *, resumes: bool = True) -> None:
        """Raise if the folder already holds results or recordings of a run.

        Args:
            resumes: True if the command has ``--resume``, for the message.
        """
        there = (*self.results, *recordings(self.path))
        if taken := [p.name for p in there if p.exists()]:
            raise ScanExistsError(
                f"{self.path} already holds {', '.join(taken)}: choose another --out"
                f"{', or continue with --resume' if resumes else ''}"
            )


def refuse_result(path: Path) -> None:
    """Raise if a path is a result of a run, which another command must not replace.

    Raises:
        ScanExistsError: the path lies in the folder of a run and has the name of a result.
    """
    folder = Folder(path.parent)
    if path.name in names_below(Folder) and path.exists() and folder.scenario.is_file():
        raise ScanExistsError(f"--out {path} is a result of the run there: choose another name")


def refuse_other_keys(overrides: Iterable[str], section: str) -> None:
    """Raise if an override changes a key outside one section of the scenario.

    Raises:
        InputError: an override of a key of another section.
    """
    others = [o for o in overrides if not o.startswith((f"{section}.", f"{section}="))]
    if others:
        raise InputError(
            f"--set {others[0]}: only keys of {section} can be changed here; others need a new run"
        )


def as_yaml(settings: ScanSettings) -> str:
    """Return the settings of a scan as YAML, defaults included."""
    return written(json.loads(settings.resolved()))


def read_metrics(path: Path) -> dict[str, Any]:
    """Read the figures of a finished run, also of an earlier version.

    Raises:
        InputError: the file cannot be read; names the file.
    """
    try:
        metrics = read_json(path)
        if not isinstance(metrics, dict):
            raise ValueError("not a mapping of names to values")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot read the figures of a run: {error}") from None
    return with_todays_names(cast(dict[str, Any], metrics))
