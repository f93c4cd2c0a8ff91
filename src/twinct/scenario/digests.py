"""One digest per stage: it shows whether a result fits a scenario or must be computed again.

It covers the keys that declare the stage as their reader (``ReadBy``) and are not at their
defaults, the content of files, the stages it depends on, and a version. Raise the version of a
stage when its computation, or a default that it reads, changes. A new key at its default changes no
digest.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from twinct.core.errors import ScenarioError
from twinct.core.files.arm_xml import read_arm_xml
from twinct.core.settings import (
    FileOf,
    Section,
    annotation_of,
    default_of,
    is_file,
    models_in,
    read_by,
)
from twinct.recon.algorithms import BUILT_IN
from twinct.robots.sections.cell import DEFAULT_KIND
from twinct.scenario.scenario import Scenario, sections_in
from twinct.uncertainty.sections import Uncertainty
from twinct.xray.sections.detector import RandomBadPixels

StageName = Literal["surface", "plan", "executed", "images", "believed", "volume"]


@dataclass(frozen=True)
class _Stage:
    """Version of a stage, and the stages it depends on. Keys declare which stages read them."""

    version: int
    on: tuple[StageName, ...] = ()


STAGES: dict[StageName, _Stage] = {
    "surface": _Stage(1),
    "plan": _Stage(1, on=("surface",)),
    "executed": _Stage(1, on=("plan",)),
    "images": _Stage(1, on=("executed",)),
    "believed": _Stage(1, on=("executed",)),
    "volume": _Stage(1, on=("images", "believed")),
}

OF_ARMS = ("motion", "cell.floor_z_mm")
"""Keys that only cells with arms read."""

_AFTER_PLAN = ("settle_speed_mm_s",)
"""Keys of the motion that count only when the arms move, unless the plan waits for their rest."""

_SINCE = {"fast": 4, "prior_tv": 3}
"""Versions of the volumes of these algorithms: the noise decides on their steps since 3, and
left-out views on the strength of ``fast`` since 4."""

_SINCE_PHOTONS = 2
"""Version of volumes from scans with noise: its photons, or air, count since then."""

_BEFORE: dict[str, object] = {
    "motion.scheme": "reactive",
    "motion.settle_s": 0.35,
    "cell.source_arm.base_position_mm": (850.0, 0.0, 0.0),
    "cell.source_arm.standoff_mm": 150.0,
    "cell.detector_arm.base_position_mm": (-850.0, 0.0, 0.0),
    "cell.detector_arm.standoff_mm": 150.0,
}
"""Former defaults, in force when the stages got their versions: such results stay valid."""

_SEEDS = ("seed", "uncertainty.seed", "uncertainty.arms.seed")
"""Seeds; only stages that draw random numbers read them."""


def stage_digests(scenario: Scenario) -> dict[StageName, str]:
    """Return the SHA-256 of each stage's inputs. A file counts by its content, not by its path.

    Raises:
        OSError: a file cannot be read. A missing file is no error: it counts as missing.
    """
    content = cache(content_digest)  # a large file is read once for all stages
    digests: dict[StageName, str] = {}
    for name, stage in STAGES.items():
        on = {base: digests[base] for base in stage.on if _stands_on(scenario, name, base)}
        keys = read_keys(scenario, "", frozenset(), partial(_reads, scenario, name), content)
        text = json.dumps(
            [name, _version(scenario, name), on, keys, _seed(scenario, name)], sort_keys=True
        )
        digests[name] = hashlib.sha256(text.encode()).hexdigest()
    return digests


def specimen_digest(scenario: Scenario) -> str:
    """Return the SHA-256 of the inputs of a scenario's truth, except for the photon energy."""
    section = scenario.specimen
    materials = [part.model_dump(mode="json", include={"material"}) for part in section.parts]
    stands = section.position_mm, section.rotation_deg
    parts = [stage_digests(scenario)["surface"], materials, stands]
    inputs = json.dumps([*parts, section.reference] if section.reference else parts)
    return hashlib.sha256(inputs.encode()).hexdigest()


def plan_digest(scenario: Scenario) -> str:
    """Return the SHA-256 of the keys that a motion plan reads.

    These are the keys of the executed poses, except for the errors and their seeds: a plan knows
    the nominal arms only. So scans that differ in their errors share one plan.
    """
    motion = scenario.motion
    late = _AFTER_PLAN if motion.trigger == "on_entry" else ()
    of_rest = {key: type(motion).model_fields[key].default for key in late}
    nominal = {"uncertainty": Uncertainty(), "motion": motion.model_copy(update=of_rest)}
    return stage_digests(scenario.model_copy(update=nominal))["executed"]


def readers(key: str) -> tuple[StageName, ...]:
    """Return the stages that read a key directly. The key is dotted, without list indices."""
    by_stage = {
        stage
        for one, stages in declared(Scenario)
        if f"{key}.".startswith(f"{one}.")
        for stage in stages
    }
    return tuple(name for name in STAGES if name in by_stage)


def declared(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, frozenset[str]]]:
    """Yield the dotted keys of a section that declare stages as their readers, with these."""
    for name, info in model.model_fields.items():
        if stages := read_by(info):
            yield f"{prefix}{name}", stages
        for section in models_in(annotation_of(info)):
            yield from declared(section, f"{prefix}{name}.")


def _reads(scenario: Scenario, stage: StageName, key: str, readers: frozenset[str]) -> bool:
    arms = scenario.cell.kind == DEFAULT_KIND  # older scenarios have no cell.kind
    if any(f"{key}.".startswith(f"{one}.") for one in (("cell.kind",) if arms else OF_ARMS)):
        return False
    if key == "motion.settle_s" and scenario.motion.trigger == "on_entry":
        return False
    if key == "source.exposure_ms" and stage == "executed":
        # A plan of the arms respects the exposure in any case.
        return arms or scenario.source.motion_samples > 1
    return key not in _SEEDS and stage in readers


def _stands_on(scenario: Scenario, stage: StageName, base: StageName) -> bool:
    return (stage, base) != ("volume", "believed") or base in scenario.reconstruction.geometries


def _version(scenario: Scenario, stage: StageName) -> int:
    """Return the version of a stage; it is the former one where the results are."""
    algorithm = scenario.reconstruction.algorithm
    if stage == "volume" and algorithm in _SINCE:
        return _SINCE[algorithm]
    if stage == "volume" and _has_noise(scenario):
        return _SINCE_PHOTONS
    return STAGES[stage].version


def _has_noise(scenario: Scenario) -> bool:
    detector = scenario.detector
    electronic = detector.readout is not None and detector.readout.electronic_noise > 0
    return detector.noise is not None or electronic


def _seed(scenario: Scenario, stage: StageName) -> int | tuple[int, int] | None:
    """Return the seed that a stage draws from; None if it draws nothing."""
    detector, noise, section = scenario.detector, scenario.uncertainty, scenario.reconstruction
    if stage == "images":
        bad_pixels = isinstance(detector.bad_pixels, RandomBadPixels)
        return scenario.seed if _has_noise(scenario) or bad_pixels else None
    if stage == "executed":
        return (scenario.arms_seed, scenario.seed) if noise.moves else None
    if stage == "believed":
        sizes = (
            (side.sigma_mm, side.rotation_sigma_deg) for side in (noise.source, noise.detector)
        )
        draws = any(map(any, sizes))
        return scenario.believed_seed if draws else None
    if stage == "volume":  # an external algorithm may draw, too
        random = getattr(section, "order", None) == "random"
        return scenario.seed if random or section.algorithm not in BUILT_IN else None
    return None


def read_keys(
    section: Section,
    key: str,
    readers: frozenset[str],
    reads: Callable[[str, frozenset[str]], bool],
    content: Callable[[Path, str], str],
) -> dict[str, Any]:
    """Return the keys of a section that a stage reads and that are not at their defaults.

    The kind of a section is always included.
    """
    data: dict[str, Any] = {}
    for name, info in type(section).model_fields.items():
        value = getattr(section, name)
        inner, stages = f"{key}.{name}" if key else name, readers | read_by(info)
        changed_since = any(other.startswith(f"{inner}.") for other in _BEFORE)
        at_default = not changed_since and value == _BEFORE.get(inner, default_of(info))
        if name not in ("kind", "algorithm") and at_default:
            continue
        if sections := sections_in(value):
            parts = [read_keys(item, inner, stages, reads, content) for item in sections]
            if reads(inner, stages) or any(parts):
                data[name] = parts
        elif isinstance(value, Section):
            part = read_keys(value, inner, stages, reads, content)
            if part or reads(inner, stages) and not isinstance(default_of(info), Section):
                data[name] = part
        elif reads(inner, stages):
            file = is_file(info) and value is not None
            data[name] = content(Path(str(value)), name) if file else to_jsonable_python(value)
            for mark in info.metadata:
                if isinstance(mark, FileOf) and (behind := mark.find(value)) is not None:
                    data[name] = [data[name], content(behind, "file")]
    return data


def content_digest(path: Path, key: str) -> str:
    """Return the SHA-256 of a file or folder that a key names, with all files that belong to it."""
    if not path.exists():
        return "gone"
    digest = hashlib.sha256()
    if key == "file":
        files = _of_arm(path)
    else:
        files = sorted(p for p in path.rglob("*") if p.is_file())
        files = files if path.is_dir() else [path] if path.is_file() else []  # no pipe is opened
    for file in files:
        with file.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def _of_arm(path: Path) -> tuple[Path, ...]:
    """Return an arm's file and all files that it includes or names; only itself if invalid."""
    try:
        return read_arm_xml(path, str(path)).files
    except ScenarioError:  # reported when the arm is built
        return (path,) if path.is_file() else ()
