"""Stages of the work on a scan: each makes files from inputs, and is due until they are those."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from twinct.runs.folder import Folder, read_metrics
from twinct.scan import ScanStore, image_digests
from twinct.scenario import Scenario


@dataclass(frozen=True)
class Stage:
    """A step of the work on a scan: its inputs, by their digest, and its outputs.

    Attributes:
        name: name of the step.
        digest: digest of all that the outputs depend on.
        outputs: files and folders that it makes.
        made_from: returns the digest that the outputs were made from; None: they are incomplete, or
            were changed since. Not called while an output is missing.
    """

    name: str
    digest: str
    outputs: tuple[Path, ...]
    made_from: Callable[[], str | None]

    @property
    def is_due(self) -> bool:
        """True if an output is missing, or was made from other inputs."""
        return not all(path.exists() for path in self.outputs) or self.made_from() != self.digest


def due(stages: Iterable[Stage]) -> list[str]:
    """Return the names of the stages that are due now."""
    return [stage.name for stage in stages if stage.is_due]


def make_due(stages: Iterable[Stage], work: Mapping[str, Callable[[], object]]) -> None:
    """Do the work of each stage, by its name, that is still due when those before it are made."""
    for stage in stages:
        if stage.is_due:
            work[stage.name]()


def run_stages(folder: Folder, scenario: Scenario) -> tuple[Stage, Stage, Stage]:
    """Return the stages of a run: ``views``, ``volume`` and ``figures``.

    A volume is judged where it is made, since a run keeps the volume of its first geometry only.
    The figures alone are due for another section ``evaluation``, or without a page or a truth.
    """
    images, volume = image_digests(scenario)["images"], folder.volume_digest(scenario)
    figures = figures_digest(scenario)
    taken = cache(partial(_taken_from, folder))  # it reads every image
    reconstructed = partial(volume_made_from, folder)
    judged = partial(figures_made_from, folder)
    return (
        Stage("views", images, (folder.scan,), taken),
        Stage("volume", volume, (folder.volume, folder.metrics), reconstructed),
        Stage("figures", figures, (folder.metrics, folder.report), judged),
    )


def volume_made_from(folder: Folder) -> str | None:
    """Return the digest that the figures of a run state; None if its volume is not the judged one.

    Raises:
        InputError: the figures cannot be read.
    """
    if folder.replaced(folder.volume):
        return None
    return read_metrics(folder.metrics).get("reconstruction_digest")


def figures_digest(scenario: Scenario) -> str:
    """Return the digest of the inputs of a run's figures, besides its volume and its truth."""
    asked = scenario.evaluation
    return _digest(asked and asked.model_dump(mode="json"))


def figures_made_from(folder: Folder) -> str | None:
    """Return the digest that the figures of a run state; None if its truth is not the judged one.

    Raises:
        InputError: the figures cannot be read.
    """
    if folder.replaced(folder.truth):
        return None
    figures = read_metrics(folder.metrics)
    if "figures_digest" in figures:
        return figures["figures_digest"]
    # Figures of earlier versions leave this to the scenario beside them.
    return _digest(folder.stated().get("evaluation") if folder.scenario.is_file() else None)


def _digest(evaluation: Any) -> str:
    return hashlib.sha256(json.dumps(evaluation, sort_keys=True).encode()).hexdigest()


def _taken_from(folder: Folder) -> str | None:
    store = ScanStore(folder.scan)
    return None if store.damage or store.missing else store.digests["images"]
