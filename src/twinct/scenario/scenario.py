"""The scenario itself: all sections, their mutual requirements, and its files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import Field, model_validator

from twinct.core.settings import (
    Conflict,
    ConflictError,
    ReadBy,
    Section,
    is_file,
    section_made_late,
    setting,
)
from twinct.evaluation.sections import Evaluation
from twinct.recon.sections.known_motion import motion_conflicts
from twinct.recon.sections.reconstruction import AnyReconstruction, default_reconstruction
from twinct.robots.sections.cell import AnyCell, Cell, GantryCell
from twinct.robots.sections.motion import Motion
from twinct.specimen.sections.specimen import Specimen
from twinct.trajectory.families import AnyTrajectory
from twinct.trajectory.sweeps import Until
from twinct.uncertainty.sections import Uncertainty
from twinct.view_planning.task import ViewTask
from twinct.xray.sections.detector import Detector
from twinct.xray.sections.engine import Xray
from twinct.xray.sections.source import Source, TubeSpectrum


class Scenario(Section):
    """Complete description of one simulation."""

    name: str = setting("scan", "Name of the scan in the report and in messages.", min_length=1)
    description: str = setting("", "Purpose of the scan; the report shows it.")
    seed: int = setting(
        0,
        "Seed of all random draws.",
        ge=0,
        lt=2**63,
        read_by=("executed", "images", "believed", "volume"),
    )
    source: Source = setting(Source(), "The X-ray source.", read_by="images")
    detector: Detector = setting(Detector(), "The flat panel.", read_by="images")
    xray: Xray = setting(Xray(), "Computation of the X-ray images.", read_by="images")
    trajectory: Annotated[AnyTrajectory, ReadBy("plan")] = Field(
        description="Commanded path of source and panel."
    )
    until: Until | None = setting(
        None,
        "Criterion by which the scan ends early; its views are then taken in sweeps over the path, "
        "each finer than the ones before. null: all views are taken, in the order of the path.",
        read_by="plan",
    )
    specimen: Specimen = Field(description="Specimen to be imaged.")
    cell: AnyCell = setting(Cell(), "The room, with two arms or a gantry.")
    motion: Motion = setting(Motion(), "Motion of the arms; not used with a gantry.")
    uncertainty: Uncertainty = section_made_late(
        Uncertainty, "Differences between commanded, executed and believed poses."
    )
    reconstruction: AnyReconstruction = section_made_late(
        default_reconstruction, "Reconstruction of the volume.", read_by="volume"
    )
    evaluation: Evaluation | None = setting(
        None, "Measurements in the volume, in addition to the figures that every run has."
    )
    task: ViewTask | None = setting(None, "Goals for which `twinct plan` chooses views.")

    def with_(self, changes: Mapping[str, Any] | None = None, /, **keys: Any) -> Scenario:
        """Return the scenario with other values of some keys.

        A closed mesh, such as ``trimesh.Trimesh``, in mm, may be the ``shape`` of a part, or the
        whole ``specimen`` of bone. Views may be the ``trajectory``: a ``ScanGeometry``; arrays
        ``(source, detector)`` or ``(source, detector, u, v)``, (views, 3), mm, then perhaps mAs,
        (views,); or one array of these columns.

        Args:
            changes: values by dotted key, such as ``{"trajectory.views": 12}``.
            **keys: values of keys at the top level, such as ``seed=1``.

        Raises:
            ScenarioError: with one sentence for each problem.
            SpecimenError: a mesh is not closed.
        """
        from twinct import scenario

        return scenario.load_scenario(self.model_dump(mode="json"), {**(changes or {}), **keys})

    def __repr__(self) -> str:
        """Return one line: name, trajectory, panel and algorithm."""
        views = getattr(self.trajectory, "views", None)
        path = f"{self.trajectory.kind}{f' of {views} views' if views else ''}"
        pixels = f"{self.detector.columns} x {self.detector.rows} px"
        return f"Scenario({self.name!r}, {path}, {pixels}, {self.reconstruction.algorithm})"

    __str__ = __repr__

    @model_validator(mode="after")
    def _sections_go_together(self) -> Scenario:
        if conflicts := self.conflicts():
            raise ConflictError(*conflicts)
        return self

    def conflicts(self) -> list[Conflict]:
        """Return the conflicts between sections."""
        contradictions = (
            *(
                self._photon_number(),
                self._noise_to_draw(),
                self._subsets(),
                self._something_to_correct(),
            ),
            *(self._time_to_expose(), self._plan_to_follow(), self._frames_to_keep()),
            self._order_of_sweeps(),
            *(self._arms_to_err(), self._plan_to_vibrate(), self._time_of_a_frame()),
            *self._motion(),
            *(self.evaluation.conflicts(self.specimen) if self.evaluation else ()),
            *(self.task.conflicts(self.specimen.names) if self.task else ()),
        )
        return [conflict for conflict in contradictions if conflict is not None]

    def _photon_number(self) -> Conflict | None:
        quantum = self.detector.noise is not None and self.detector.noise.kind == "quantum"
        tube = isinstance(self.source.spectrum, TubeSpectrum)
        if not quantum or tube or self.source.photons_per_mm2_mas is not None:
            return None
        return Conflict(
            "detector.noise of kind 'quantum' needs a photon number: give "
            "source.photons_per_mm2_mas, or a source.spectrum of kind 'tube'",
            ("detector.noise", "source.photons_per_mm2_mas", "source.spectrum"),
        )

    def _noise_to_draw(self) -> Conflict | None:
        gain = getattr(self.detector.noise, "gain", 1.0)
        if gain == 1:
            return None
        return Conflict(
            f"detector.noise.gain is {gain:g}, but a simulated scan has 1: noise of kind "
            "'quantum' and a detector.point_spread simulate what neighbours share",
            ("detector.noise.gain",),
        )

    def _subsets(self) -> Conflict | None:
        views = getattr(self.trajectory, "views", None)
        subsets = getattr(self.reconstruction, "subsets", None)
        if views is None or subsets is None or subsets <= views:
            return None
        return Conflict(
            f"reconstruction.subsets ({subsets}) must be at most trajectory.views ({views})",
            ("reconstruction.subsets", "trajectory.views"),
        )

    def _something_to_correct(self) -> Conflict | None:
        if self.reconstruction.beam_hardening is None or self.source.spectrum is not None:
            return None
        return Conflict(
            "reconstruction.beam_hardening needs a source.spectrum: a beam of one energy, as here, "
            "does not harden",
            ("reconstruction.beam_hardening", "source.spectrum"),
        )

    def _frames_to_keep(self) -> Conflict | None:
        if not self.detector.keep or not (self.source.ideal and self.detector.ideal):
            return None
        return Conflict(
            "detector.keep: an ideal source and detector have no raw, flat or dark images: set "
            "detector.readout",
            ("detector.keep", "detector.readout"),
        )

    def _time_to_expose(self) -> Conflict | None:
        cell, source = self.cell, self.source
        if not isinstance(cell, GantryCell) or source.motion_samples == 1:
            return None
        if source.exposure_ms <= 1000 * cell.view_s:
            return None
        return Conflict(
            f"source.exposure_ms ({source.exposure_ms:g}) must be at most the time of a view, "
            f"{1000 * cell.view_s:g} ms (cell.view_s), as source.motion_samples is above 1",
            ("source.exposure_ms", "source.motion_samples", "cell.view_s"),
        )

    def _time_of_a_frame(self) -> Conflict | None:
        cell, frame_ms = self.cell, self.detector.frame_ms
        if not isinstance(cell, GantryCell) or frame_ms is None or frame_ms <= 1000 * cell.view_s:
            return None
        return Conflict(
            f"detector.frame_ms ({frame_ms:g}) must be at most the time of a view, "
            f"{1000 * cell.view_s:g} ms (cell.view_s)",
            ("detector.frame_ms", "cell.view_s"),
        )

    def _arms_to_err(self) -> Conflict | None:
        keys = tuple(f"uncertainty.{name}" for name in self.uncertainty.of_arms)
        if not isinstance(self.cell, GantryCell) or not keys:
            return None
        what = (
            f"{' and '.join(keys)}: a gantry has no arms; uncertainty.views applies to any machine"
        )
        return Conflict(what, (*keys, "uncertainty.preset", "cell.kind"))

    def _plan_to_vibrate(self) -> Conflict | None:
        servos = self.uncertainty.servos
        shaken = [
            f"uncertainty.servos.{side}.resonance_hz"
            for side, servo in (("source", servos.source), ("detector", servos.detector))
            if servo.resonance_hz
        ]
        if self.motion.scheme == "planned" or not shaken:
            return None
        what = (
            f"{' and '.join(shaken)}: vibration follows from the plan: set motion.scheme: planned"
        )
        return Conflict(what, (*shaken, "motion.scheme"))

    def _order_of_sweeps(self) -> Conflict | None:
        if self.until is None or self.motion.order == "given":
            return None
        return Conflict(
            "motion.order: shortest contradicts until, which takes the views in sweeps over the "
            "path: leave out one of them",
            ("until", "motion.order"),
        )

    def _motion(self) -> Iterator[Conflict]:
        section = self.reconstruction
        return motion_conflicts(
            section.motion,
            moves=self.specimen.motion is not None,
            algorithm=section.algorithm,
            metal=section.metal is not None,
            lag=self.detector.lag > 0,
        )

    def _plan_to_follow(self) -> Conflict | None:
        if self.motion.plan is None or self.motion.scheme == "planned":
            return None
        return Conflict(
            f"motion.plan ({self.motion.plan}) needs motion.scheme: planned",
            ("motion.plan", "motion.scheme"),
        )

    def resolved(self) -> str:
        """Return the whole scenario, defaults included, as canonical JSON."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))

    @property
    def engine(self) -> str | None:
        """Name of the X-ray engine; None if all parts are cast by rays of their own."""
        own = all(part.own_rays for part in self.specimen.parts)
        return None if own else self.xray.engine

    @property
    def believed_seed(self) -> int:
        """Seed of the errors of believed poses."""
        return self.seed if self.uncertainty.seed is None else self.uncertainty.seed

    @property
    def arms_seed(self) -> int:
        """Seed of the arms' errors, which are constant during a scan."""
        own = self.uncertainty.arms.seed
        return self.seed if own is None else own

    def named_parts(self) -> list[tuple[str, str]]:
        """Return the keys of the evaluation that name a part or a label, each with the name."""
        references = self.evaluation.references() if self.evaluation else ()
        return [(f"evaluation.{key}", name) for key, name, kind in references if kind == "part"]

    def unknown_parts(self, parts: Sequence[str]) -> list[Conflict]:
        """Return the conflicts of objectives that name a part which is not among some names."""
        return self.task.unknown_parts(parts) if self.task else []

    def files(self) -> dict[str, Path]:
        """Return the files and folders that the scenario names in any section, by key."""
        return dict(files_in(self, ""))


def files_in(section: Section, key: str) -> Iterator[tuple[str, Path]]:
    """Yield key and path of each file that a section names."""
    for name, info in type(section).model_fields.items():
        value, inner = getattr(section, name), f"{key}.{name}" if key else name
        for index, item in enumerate(sections_in(value)):
            yield from files_in(item, f"{inner}.{index}")
        if isinstance(value, Section):
            yield from files_in(value, inner)
        elif is_file(info) and value is not None:
            yield inner, Path(value)


def sections_in(value: object) -> tuple[Section, ...]:
    """Return the sections in a tuple; an empty tuple for any other value."""
    items = cast("tuple[object, ...]", value) if isinstance(value, tuple) else ()
    return tuple(item for item in items if isinstance(item, Section))
