"""The folder of a run: what lies where, and whether it may be written."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml

from twinct.errors import InputError, ScanExistsError
from twinct.files.writing import check_folder, draft_of
from twinct.scenario import Scenario, stage_digests


@dataclass(frozen=True)
class Folder:
    """Where a run keeps what, below its ``--out``."""

    path: Path

    @property
    def scan(self) -> Path:
        """The scan store."""
        return self.path / "scan.zarr"

    @property
    def volume(self) -> Path:
        """The reconstruction."""
        return self.path / "volume.nii"

    @property
    def metrics(self) -> Path:
        """The figures."""
        return self.path / "metrics.json"

    @property
    def report(self) -> Path:
        """The report."""
        return self.path / "report.html"

    @property
    def checkpoints(self) -> Path:
        """Reconstructions that are under way."""
        return self.path / "checkpoints"

    @property
    def scenario(self) -> Path:
        """The scenario as it was run, defaults included."""
        return self.path / "scenario.yaml"

    @property
    def seconds(self) -> Path:
        """Seconds of a run that is under way."""
        return self.path / "seconds.json"

    @property
    def logs(self) -> Path:
        """What the nodes of the ROS 2 link said."""
        return self.path / "log"

    @property
    def log(self) -> Path:
        """What happened."""
        return self.path / "twinct.log"

    @property
    def lock(self) -> Path:
        """Held by the process that works here."""
        return self.path / "twinct.lock"

    def finished(self, scenario: Scenario) -> bool:
        """Whether everything of this very scenario is there."""
        if not all(p.exists() for p in (self.scan, self.volume, self.metrics, self.report)):
            return False
        digest = stage_digests(scenario)["volume"]
        return read_metrics(self.metrics).get("reconstruction_digest") == digest

    def refuse_others(self) -> None:
        """Raise where something else than a run of before is in the way."""
        own = (
            *(self.scan, self.volume, self.metrics, self.report, self.checkpoints, self.scenario),
            *(self.seconds, self.logs, self.log, self.lock, self.scan.with_name("scan.zarr.new")),
        )
        names = {name for p in own for name in (p.name, draft_of(p).name)}
        check_folder(self.path, names)

    def refuse_if_taken(self) -> None:
        """Raise where a run of before must not be touched."""
        taken = [p.name for p in (self.scan, self.volume, self.metrics, self.report) if p.exists()]
        if taken:
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
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable figures of a run: {error}") from None
    if not isinstance(metrics, dict):
        raise InputError(f"{path}: not readable figures of a run: no mapping of names to values")
    return cast(dict[str, Any], metrics)
