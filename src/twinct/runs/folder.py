"""The folder of a run: what lies where, and whether it may be written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from twinct.errors import InputError, ScanExistsError
from twinct.files.below import Below, names_below
from twinct.files.plain_json import read_json
from twinct.files.plain_yaml import read_file, written
from twinct.files.writing import check_folder, draft_of
from twinct.record import recordings
from twinct.scan import OWN, named_geometries
from twinct.scenario import Scenario, load_scenario, stage_digests


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
        arms: both of them, as the scan of a phantom told.
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
    scan = Below("scan.zarr")
    volume = Below("volume.nii")
    truth = Below("truth.nii")
    metrics = Below("metrics.json")
    report = Below("report.html")
    geometries = Below("geometries")
    arms = Below("arms.json")
    reconstructions = Below("reconstructions")
    checkpoints = Below("checkpoints")
    scenario = Below("scenario.yaml")
    views = Below("views.csv")
    seconds = Below("seconds.json")
    logs = Below("log")
    log = Below("twinct.log")
    lock = Below("twinct.lock")

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

    def measured(self, scenario: Scenario) -> bool:
        """Whether the figures of a finished run are those that a scenario asks for."""
        if not self.scenario.is_file():
            return True
        told = read_file(self.scenario, "scenario").value
        told = cast("dict[str, Any]", told).get("evaluation") if isinstance(told, dict) else None
        asked = scenario.evaluation
        return told == (asked and asked.model_dump(mode="json"))

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
        own = names_below(Folder)
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


def refuse_other_keys(overrides: Iterable[str], section: str) -> None:
    """Refuse what would change more of a run than one of its sections.

    Raises:
        InputError: an override of another key.
    """
    others = [o for o in overrides if not o.startswith((f"{section}.", f"{section}="))]
    if others:
        raise InputError(
            f"--set {others[0]}: only keys of {section} can be changed here; a scan with others is "
            "another run"
        )


def as_yaml(scenario: Scenario) -> str:
    """The resolved scenario, defaults included."""
    return written(json.loads(scenario.resolved()))


def read_metrics(path: Path) -> dict[str, Any]:
    """Figures of a finished run.

    Raises:
        InputError: they cannot be read; names the file.
    """
    try:
        metrics = read_json(path)
        if not isinstance(metrics, dict):
            raise ValueError("no mapping of names to values")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable figures of a run: {error}") from None
    return cast(dict[str, Any], metrics)
