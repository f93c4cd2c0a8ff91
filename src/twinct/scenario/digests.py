"""One digest a stage: whether a result is that of a scenario, or has to be made anew.

It covers the keys that the stage reads and that are not at their default, the content of files,
the stages it stands on, and a version. Raise the version of a stage when a default that it reads or
what it computes changes. A new key at its default changes no digest.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pydantic_core import to_jsonable_python

from twinct.errors import ScenarioError
from twinct.files.arm_xml import read_arm_xml
from twinct.recon.algorithms import BUILT_IN
from twinct.scenario.cell import DEFAULT_KIND
from twinct.scenario.detector import RandomBadPixels
from twinct.scenario.scenario import Scenario, sections_in
from twinct.settings import FILE_KEYS, Section

StageName = Literal["surface", "plan", "executed", "images", "believed", "volume"]


@dataclass(frozen=True)
class _Stage:
    """What a stage reads, keys of sections or patterns of them, and on which stages it stands."""

    version: int
    reads: tuple[str, ...]
    on: tuple[StageName, ...] = ()


STAGES: dict[StageName, _Stage] = {
    "surface": _Stage(
        1, ("specimen.parts.shape", "specimen.parts.position_mm", "specimen.parts.rotation_deg")
    ),
    "plan": _Stage(
        1,
        (
            *("trajectory", "detector.columns", "detector.rows", "detector.pixel_pitch_mm"),
            *("specimen.position_mm", "specimen.rotation_deg", "cell.table", "cell.floor_z_mm"),
            "cell.zones",
            *("cell.*_arm.model", "cell.*_arm.base_position_mm", "cell.*_arm.base_rotation_deg"),
            *("cell.*_arm.file", "cell.*_arm.base", "cell.*_arm.flange", "cell.*_arm.home"),
            *("cell.*_arm.standoff_mm", "cell.*_arm.tool_rotation_deg"),
            *(
                "motion.ik",
                "motion.clearance_mm",
                "motion.order",
                "motion.*_roll",
                "motion.scheme",
                "motion.plan",
                "cell.kind",
            ),
        ),
        on=("surface",),
    ),
    "executed": _Stage(
        1,
        (
            *("cell.*_arm.tool_mass_kg", "cell.*_arm.torque_scale", "cell.*_arm.speed_scale"),
            *("cell.*_arm.joint_speed_deg_s", "cell.timestep_ms", "cell.view_s"),
            *("motion.trigger", "motion.tolerance_mm", "motion.acceleration_deg_s2"),
            *("motion.tool_speed_mm_s", "motion.settle_s"),
            *("motion.jerk_deg_s3", "motion.settle_speed_mm_s", "motion.timeout_s"),
            *("source.motion_samples", "source.exposure_ms"),
            *("uncertainty.arms", "uncertainty.views", "uncertainty.patient", "seed"),
        ),
        on=("plan",),
    ),
    "images": _Stage(
        1, ("source", "detector", "specimen.parts.material", "seed"), on=("executed",)
    ),
    "believed": _Stage(
        1,
        (
            *("uncertainty.source", "uncertainty.detector", "uncertainty.encoder_step_deg"),
            *("uncertainty.calibration", "uncertainty.seed", "seed"),
        ),
        on=("executed",),
    ),
    # Of the detector what it leaves out: volumes from before it did were others.
    "volume": _Stage(
        1,
        # The reference counts for the figures, which come with the volume.
        ("reconstruction", "seed", "detector.bad_pixels", "specimen.reference"),
        on=("images", "believed"),
    ),
}

COUNT_FOR_NONE = (
    *("name", "description", "specimen.parts.name", "evaluation", "uncertainty.preset"),
    "task",
)
"""Keys, and sections, that change neither scan nor truth nor volume."""

_OF_ARMS = ("motion", "cell.floor_z_mm")
"""Keys that only arms read."""

_BEFORE: dict[str, object] = {
    "motion.scheme": "reactive",
    "cell.source_arm.base_position_mm": (850.0, 0.0, 0.0),
    "cell.source_arm.standoff_mm": 150.0,
    "cell.detector_arm.base_position_mm": (-850.0, 0.0, 0.0),
    "cell.detector_arm.standoff_mm": 150.0,
}
"""Defaults that were others when a stage had its version: results made with those stay valid."""

_SEEDS = ("seed", "uncertainty.seed", "uncertainty.arms.seed")
"""Read only by a stage that draws."""


def stage_digests(scenario: Scenario) -> dict[StageName, str]:
    """SHA-256 of what each stage's result depends on; a file counts by its content, not its place.

    Raises:
        OSError: a file that cannot be read. One that is gone counts as such.
    """
    content = cache(content_digest)  # a large file is read once for all stages
    found: dict[StageName, str] = {}
    for name, stage in STAGES.items():
        on = {base: found[base] for base in stage.on if _stands_on(scenario, name, base)}
        told = _told(scenario, "", lambda key, name=name: _reads(scenario, name, key), content)
        text = json.dumps([name, stage.version, on, told, _seed(scenario, name)], sort_keys=True)
        found[name] = hashlib.sha256(text.encode()).hexdigest()
    return found


def specimen_digest(scenario: Scenario) -> str:
    """SHA-256 of what the truth of a scenario depends on, but for the photon energy."""
    section = scenario.specimen
    materials = [part.model_dump(mode="json", include={"material"}) for part in section.parts]
    stands = section.position_mm, section.rotation_deg
    parts = [stage_digests(scenario)["surface"], materials, stands]
    told = json.dumps([*parts, section.reference] if section.reference else parts)
    return hashlib.sha256(told.encode()).hexdigest()


def readers(key: str) -> tuple[StageName, ...]:
    """The stages that read a key themselves: a dotted one, without the indices of lists."""
    return tuple(name for name, stage in STAGES.items() if _matches(key, stage.reads))


@cache
def _matches(key: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatchcase(key, p) or fnmatchcase(key, f"{p}.*") for p in patterns)


def _reads(scenario: Scenario, stage: StageName, key: str) -> bool:
    arms = scenario.cell.kind == DEFAULT_KIND  # which is no news: it has not always been a key
    if _matches(key, ("cell.kind",) if arms else _OF_ARMS):
        return False
    if key == "source.exposure_ms" and stage == "executed":
        return scenario.source.motion_samples > 1  # else an image takes no time
    return key not in _SEEDS and _matches(key, STAGES[stage].reads)


def _stands_on(scenario: Scenario, stage: StageName, base: StageName) -> bool:
    return (stage, base) != ("volume", "believed") or base in scenario.reconstruction.geometries


def _seed(scenario: Scenario, stage: StageName) -> int | tuple[int, int] | None:
    """What a stage draws with; None where it draws nothing."""
    detector, noise, section = scenario.detector, scenario.uncertainty, scenario.reconstruction
    if stage == "images":
        electronic = detector.readout is not None and detector.readout.electronic_noise > 0
        bad_pixels = isinstance(detector.bad_pixels, RandomBadPixels)
        return scenario.seed if detector.noise or electronic or bad_pixels else None
    if stage == "executed":
        return (scenario.arms_seed, scenario.seed) if noise.moves else None
    if stage == "believed":
        sizes = (
            (side.sigma_mm, side.rotation_sigma_deg) for side in (noise.source, noise.detector)
        )
        draws = any(map(any, sizes))
        return scenario.believed_seed if draws else None
    if stage == "volume":  # an algorithm from elsewhere may draw what it likes
        random = getattr(section, "order", None) == "random"
        return scenario.seed if random or section.algorithm not in BUILT_IN else None
    return None


def _told(
    section: Section, key: str, reads: Callable[[str], bool], content: Callable[[Path, str], str]
) -> dict[str, Any]:
    """What a stage reads of a section and is not at its default; always which kind it is."""
    told: dict[str, Any] = {}
    for name, info in type(section).model_fields.items():
        value = getattr(section, name)
        inner = f"{key}.{name}" if key else name
        changed_since = any(other.startswith(f"{inner}.") for other in _BEFORE)
        at_default = not changed_since and value == _BEFORE.get(inner, info.default)
        if name not in ("kind", "algorithm") and at_default:
            continue
        if sections := sections_in(value):
            parts = [_told(item, inner, reads, content) for item in sections]
            if reads(inner) or any(parts):
                told[name] = parts
        elif isinstance(value, Section):
            part = _told(value, inner, reads, content)
            if part or reads(inner) and not isinstance(info.default, Section):
                told[name] = part
        elif reads(inner):
            is_file = name in FILE_KEYS and value is not None
            told[name] = content(Path(str(value)), name) if is_file else to_jsonable_python(value)
    return told


def content_digest(path: Path, key: str) -> str:
    """SHA-256 of a file or folder that a key names, with all that belongs to it."""
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
    """The file of an arm with all that it includes and names; alone where it is broken."""
    try:
        return read_arm_xml(path, str(path)).files
    except ScenarioError:  # told when the arm is built
        return (path,) if path.is_file() else ()
