"""The folder of a run: what lies where, and whether it may be written."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml

from twinct.errors import InputError, ScanExistsError
from twinct.files.writing import check_folder, draft_of
from twinct.record import recordings
from twinct.scan import OWN, named_geometries
from twinct.scenario import Scenario, load_scenario, stage_digests


class _Below:
    """A path below the folder, by its name."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, folder: Folder, owner: type[Folder]) -> Path:
        return folder.path / self.name


@dataclass(frozen=True)
class Folder:
    """Where a run keeps what, below its ``--out``.

    Attributes:
        path: the folder itself.
        scan: the scan store.
        volume: the reconstruction.
        truth: what it is judged against, on the same grid.
        metrics: the figures.
        report: the report.
        geometries: derived from the scan, a file each.
        reconstructions: others of the same scan, a folder each.
        checkpoints: reconstructions that are under way.
        scenario: as it was run, defaults included.
        views: of a scan that was imported from another tool's recording.
        seconds: of a run that is under way.
        logs: what the nodes of the ROS 2 link said.
        log: what happened.
        lock: held by the process that works here.
    """

    path: Path
    scan = _Below("scan.zarr")
    volume = _Below("volume.nii")
    truth = _Below("truth.nii")
    metrics = _Below("metrics.json")
    report = _Below("report.html")
    geometries = _Below("geometries")
    reconstructions = _Below("reconstructions")
    checkpoints = _Below("checkpoints")
    scenario = _Below("scenario.yaml")
    views = _Below("views.csv")
    seconds = _Below("seconds.json")
    logs = _Below("log")
    log = _Below("twinct.log")
    lock = _Below("twinct.lock")

    @property
    def results(self) -> tuple[Path, ...]:
        """What a finished run leaves."""
        return self.scan, self.volume, self.metrics, self.report

    def scenario_of_run(self, overrides: tuple[str, ...] = (), *, planned: bool) -> Scenario:
        """The scenario that the run was made with, some of its keys changed.

        A scan from before there were plans, which is not ``planned``, does not say so.
        """
        scheme = () if planned else ("motion.scheme=reactive",)
        return load_scenario(self.scenario, (*scheme, *overrides))

    def finished(self, scenario: Scenario) -> bool:
        """Whether everything of this very scenario is there."""
        if not all(p.exists() for p in self.results):
            return False
        told = read_metrics(self.metrics).get("reconstruction_digest")
        return told == self.volume_digest(scenario)

    def volume_digest(self, scenario: Scenario) -> str:
        """Of all that the volume depends on, derived geometries included."""
        digest = stage_digests(scenario)["volume"]
        derived = [name for name in scenario.reconstruction.geometries if name not in OWN]
        if derived:
            there = named_geometries(self.geometries)
            digest += "".join(there[name].digest for name in derived if name in there)
            digest = hashlib.sha256(digest.encode()).hexdigest()
        return digest

    def refuse_others(self) -> None:
        """Raise where something else than a run of before is in the way."""
        own = [part.name for part in vars(Folder).values() if isinstance(part, _Below)]
        drafts = [draft_of(self.path / name).name for name in (*own, "scan.zarr.new")]
        recorded = (path.name for path in recordings(self.path))
        check_folder(self.path, {*own, "scan.zarr.new", *drafts, *recorded})

    def refuse_if_taken(self) -> None:
        """Raise where a run of before must not be touched."""
        there = (*self.results, *recordings(self.path))
        if taken := [p.name for p in there if p.exists()]:
            raise ScanExistsError(
                f"{self.path} already holds {', '.join(taken)}: "
                "choose another --out, or go on with --resume"
            )


def as_yaml(scenario: Scenario) -> str:
    """The resolved scenario, defaults included."""
    return yaml.safe_dump(json.loads(scenario.resolved()), sort_keys=False)


def read_metrics(path: Path) -> dict[str, Any]:
    """Figures of a finished run.

    Raises:
        InputError: they cannot be read; names the file.
    """
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(metrics, dict):
            raise ValueError("no mapping of names to values")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable figures of a run: {error}") from None
    return cast(dict[str, Any], metrics)
