"""Settings of a scan: those of its scenario or, for an imported scan, what is known of it.

An imported scan has a panel and a reconstruction. Its beam and the shape of its object may be
stated; nothing else of a scenario applies to it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol, Self, cast

from pydantic import ValidationError, model_validator
from pydantic_core import to_jsonable_python

from twinct.core.errors import InputError, ScenarioError
from twinct.core.settings import (
    Conflict,
    ConflictError,
    Section,
    default_of,
    section_made_late,
    setting,
)
from twinct.evaluation.sections import Evaluation
from twinct.recon.sections.known_motion import motion_conflicts
from twinct.recon.sections.reconstruction import (
    SECTIONS,
    AnyReconstruction,
    default_reconstruction,
)
from twinct.scenario.digests import content_digest, read_keys
from twinct.scenario.loading import parse_scenario, validated
from twinct.scenario.messages import refusal
from twinct.scenario.reading import Overrides, drafted, varied
from twinct.scenario.scenario import files_in
from twinct.specimen.sections.specimen import Specimen
from twinct.xray.sections.detector import Detector
from twinct.xray.sections.engine import Xray
from twinct.xray.sections.source import Source

STATED = "stated"
"""Name of the geometry that an imported scan came with."""

_VERSION = 1
"""Version of the digest of an imported scan's volume."""


class ScanSettings(Protocol):
    """Sections that the reconstruction of any scan reads; a ``Scenario`` has them, too.

    What is not known is None: ``source`` and ``specimen`` of an imported scan.
    """

    @property
    def name(self) -> str:
        """Name of the scan."""
        ...

    @property
    def description(self) -> str:
        """Purpose or origin of the scan."""
        ...

    @property
    def seed(self) -> int:
        """Seed of random draws."""
        ...

    @property
    def source(self) -> Source | None:
        """The beam."""
        ...

    @property
    def detector(self) -> Detector:
        """The panel."""
        ...

    @property
    def xray(self) -> Xray:
        """Computation of X-ray images."""
        ...

    @property
    def specimen(self) -> Specimen | None:
        """The object."""
        ...

    @property
    def reconstruction(self) -> AnyReconstruction:
        """Algorithm, grid and corrections."""
        ...

    @property
    def evaluation(self) -> Evaluation | None:
        """Measurements in the volume."""
        ...

    def with_(self, changes: Mapping[str, Any] | None = None, /, **keys: Any) -> ScanSettings:
        """Return the settings with other values of some dotted keys."""
        ...

    def model_copy(self, *, update: Mapping[str, Any] | None = None) -> Self:
        """Return a copy with other sections, unchecked."""
        ...

    def conflicts(self) -> list[Conflict]:
        """Return the conflicts between sections."""
        ...

    def resolved(self) -> str:
        """Return all settings, defaults included, as canonical JSON."""
        ...

    def model_dump(self, *, mode: str) -> dict[str, Any]:
        """Return all settings as plain data."""
        ...


class ImportedSettings(Section):
    """Settings of an imported scan: all that is known besides its images and their geometry."""

    name: str = setting("measured", "Name of the scan in the report and messages.", min_length=1)
    description: str = setting("", "Origin of the scan; the report shows it.")
    seed: int = setting(0, "Seed of random draws of an algorithm.", ge=0, lt=2**63)
    source: Source | None = setting(None, "The beam; null: it is not known.", read_by="volume")
    detector: Detector = setting(Detector(), "The panel.", read_by="volume")
    xray: Xray = setting(Xray(), "Computation of predicted images.")
    specimen: Specimen | None = setting(None, "The object; null: its shape is not known.")
    reconstruction: AnyReconstruction = section_made_late(
        partial(default_reconstruction, geometry=STATED),
        "Reconstruction of the volume.",
        read_by="volume",
    )
    evaluation: Evaluation | None = setting(
        None, "Measurements in the volume that need no truth, in regions of the world."
    )

    @model_validator(mode="after")
    def _sections_go_together(self) -> ImportedSettings:
        if conflicts := self.conflicts():
            raise ConflictError(*conflicts)
        return self

    def conflicts(self) -> list[Conflict]:
        """Return the conflicts between sections."""
        return list(self._conflicts())

    def _conflicts(self) -> Iterator[Conflict]:
        section = self.reconstruction
        spectrum = self.source.spectrum if self.source else None
        if section.beam_hardening is not None and spectrum is None:
            yield Conflict(
                "reconstruction.beam_hardening needs a source.spectrum: a beam of one energy, as "
                "here, does not harden",
                ("reconstruction.beam_hardening", "source.spectrum"),
            )
        if self.evaluation is not None:
            yield from self.evaluation.conflicts(self.specimen)
        yield from motion_conflicts(
            section.motion,
            moves=False,
            algorithm=section.algorithm,
            metal=section.metal is not None,
            lag=False,
        )

    def with_(self, changes: Mapping[str, Any] | None = None, /, **keys: Any) -> ImportedSettings:
        """Return the settings with other values of some keys; see ``Scenario.with_``."""
        return load_imported(self.model_dump(mode="json"), {**(changes or {}), **keys})

    def resolved(self) -> str:
        """Return all settings, defaults included, as canonical JSON."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))

    def files(self) -> dict[str, Path]:
        """Return the files that the settings name, by key."""
        return dict(files_in(self, ""))

    def volume_digest(self, images: str) -> str:
        """Return the SHA-256 of all that a volume depends on, except for its geometry.

        Args:
            images: digest of the images.
        """

        def reads(_: str, readers: frozenset[str]) -> bool:
            return "volume" in readers

        keys = read_keys(self, "", frozenset(), reads, cache(content_digest))
        draws = getattr(self.reconstruction, "order", None) == "random"
        text = json.dumps(
            ["imported", _VERSION, images, keys, self.seed if draws else None], sort_keys=True
        )
        return hashlib.sha256(text.encode()).hexdigest()


def load_imported(
    source: str | Path | Mapping[str, Any],
    overrides: Overrides = (),
    changes: Mapping[str, Any] | None = None,
) -> ImportedSettings:
    """Read and validate the settings of an imported scan, with some keys changed.

    Args:
        source: YAML file or plain data, as of this version or an earlier one.
        overrides: as of ``load_scenario``.
        changes: further values by dotted key, as plain data with absolute paths.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    draft = drafted(source, overrides, extends=not isinstance(source, Mapping))
    if _is_forged(draft.data):
        draft.data = _as_settings(draft.data)
    section: Any = draft.data.get("reconstruction")
    if isinstance(section, dict):
        draft.data["reconstruction"] = {"geometry": STATED, **section}
    if changes:
        draft = varied(draft, changes, dict.fromkeys(changes, ""))
    try:
        text = json.dumps(draft.data, default=str)
        return ImportedSettings.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise refusal(draft, error, ImportedSettings) from None


class _Reconstructed(Section):
    """Only the section that another reconstruction changes."""

    reconstruction: AnyReconstruction


def reconstructed_by(
    stated: ScanSettings, algorithm: str | None, settings: Mapping[str, Any]
) -> ScanSettings:
    """Return settings with another algorithm, or other keys of it; only they are validated.

    Args:
        stated: valid settings; those keys that the algorithm has, too, stay.
        algorithm: name of the algorithm; None: the stated one.
        settings: keys of the section ``reconstruction``.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    section = stated.reconstruction.model_dump(mode="json")
    if algorithm is not None:
        known = SECTIONS[algorithm].model_fields if algorithm in SECTIONS else section
        section = {key: value for key, value in section.items() if key in known}
        section["algorithm"] = algorithm
    draft = drafted({"reconstruction": section | dict(settings)}, extends=False)
    changed = validated(draft, _Reconstructed).reconstruction
    result = stated.model_copy(update={"reconstruction": changed})
    if conflicts := result.conflicts():
        raise ScenarioError([conflict.message for conflict in conflicts])
    return result


def parse_settings(data: Mapping[str, Any]) -> ScanSettings:
    """Validate the settings of any scan given as plain data, such as a scan store's.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    return load_imported(data) if is_imported(data) else parse_scenario(data)


def is_imported(data: Mapping[str, Any]) -> bool:
    """Return whether plain data are the settings of an imported scan, not those of a scenario."""
    return "trajectory" not in data or _is_forged(data)


def _is_forged(data: Mapping[str, Any]) -> bool:
    """Return whether an earlier version wrote an imported scan as the scenario of a gantry."""
    specimen = cast("Mapping[str, Any]", data.get("specimen"))
    return isinstance(specimen, dict) and specimen.get("unknown") is True


def _as_settings(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a forged scenario says of the scan itself.

    Its trajectory, gantry and uncertainty were made up, and so was a beam that nobody stated.
    """
    kept = {key: value for key, value in data.items() if key in ImportedSettings.model_fields}
    object_ = {key: value for key, value in kept.pop("specimen").items() if key != "unknown"}
    if object_ != {
        key: to_jsonable_python(default_of(Specimen.model_fields[key])) for key in object_
    }:
        kept["specimen"] = object_
    if kept.get("source") == Source().model_dump(mode="json"):
        del kept["source"]
    kept["detector"] = {**kept.get("detector", {}), "bad_pixels": None}  # the store has them
    section = dict(kept.get("reconstruction", {}))
    section["geometry"] = as_stated(section.get("geometry", STATED))
    return {**kept, "reconstruction": section}


def as_stated(geometry: Any) -> Any:
    """Return the names of geometries; a forged scenario had three for the stated one."""
    names = [geometry] if isinstance(geometry, str) else list(geometry)
    own = ("commanded", "executed", "believed")
    renamed = list(dict.fromkeys(STATED if name in own else name for name in names))
    return renamed[0] if len(renamed) == 1 else renamed


def beam_of(settings: ScanSettings, key: str) -> Source:
    """Return the beam, which a key of the settings needs.

    Raises:
        InputError: an imported scan does not state it.
    """
    if settings.source is None:
        raise InputError(
            f"{key}: it needs the beam of the scan, which is not known: state source, such as "
            "source.energy_kev or source.spectrum, in its scenario.yaml"
        )
    return settings.source
