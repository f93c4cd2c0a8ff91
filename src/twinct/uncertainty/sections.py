"""Differences between commanded, executed and believed poses."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import (
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo

from twinct.core.extensions import Registry
from twinct.core.settings import (
    Conflict,
    ConflictError,
    Extensible,
    Finite,
    Length,
    NonNegative,
    Positive,
    Section,
    Vector,
    require_usable,
    setting,
)
from twinct.uncertainty.error_terms import SIDES, ErrorSettings, ErrorTerm, size

RANDOM_WALK = "accumulated as a random walk"
DALY = "Daly et al., Med. Phys. 35 (2008) 2124"


class PoseNoise(Section):
    """Gaussian noise of the reported poses, for each axis."""

    sigma_mm: NonNegative = setting(0.1, "Standard deviation for each axis.", source="the paper")
    cutoff_mm: Length | None = setting(
        0.15,
        "Largest deviation along each axis; larger ones are drawn again. null: no limit.",
        source="the paper: repeatability",
    )
    rotation_sigma_deg: NonNegative = setting(
        0.0, "Standard deviation of the rotation about each axis of the tool."
    )
    correlation_views: NonNegative = setting(
        0.0,
        "Correlation length of the noise in views: d views apart, the correlation is exp(-d^2 / "
        "2 length^2). 0: no correlation. Needs cutoff_mm: null.",
    )

    @model_validator(mode="after")
    def _smooth_is_not_cut(self) -> PoseNoise:
        if self.correlation_views and self.cutoff_mm is not None:
            what = (
                "correlation_views above 0 needs cutoff_mm: null, because only white noise can "
                "be cut off"
            )
            raise ConflictError(Conflict(what, ("cutoff_mm", "correlation_views")))
        return self


class OneArmErrors(ErrorSettings):
    """Differences between an arm and its controller's model; those left out are of both arms."""

    joint_offset_deg: Finite = size("Error of each joint's zero.")
    link_mm: Finite = size(
        "Error of each joint's position on the previous link, along each axis: lengths and "
        "offsets.",
    )
    link_deg: Finite = size("Tilt of each joint's axis about the two axes perpendicular to it.")
    base_mm: Finite = size("Error of the base position along each axis: registration of the arm.")
    base_deg: Finite = size("Error of the base rotation about each axis.")
    tool_mm: Finite = size(
        "Error of focal spot and panel on their flange, along each axis: hand-eye calibration."
    )
    tool_deg: Finite = size("Rotation error of source and panel on their flange, about each axis.")
    windup_deg: Finite = size(
        "Deflection of each joint at its published torque limit, behind the encoder; the weight "
        "of links and tool deflects it in proportion.",
    )
    windup_spread: float = setting(
        0.0, "Spread of the deflection from joint to joint, as a share of windup_deg.", ge=0, le=0.3
    )
    gear_deg: Finite = size(
        "Amplitude of each joint's gear error, a sine of the joint angle with a random phase."
    )
    rail_mm: Finite = size(
        "Error of the position of a rail's carriage along each axis, in waves along the rail."
    )
    rail_deg: Finite = size("Tilt of the carriage about each axis, in waves along the rail.")
    rail_period_mm: Positive = setting(1000.0, "Length of these waves.")
    drift_mm: Finite = size(
        "Thermal growth of each link along each axis until it is warm. The arms are calibrated "
        "warm; the growth that is still missing decays with the time constant warm_up_min.",
    )
    warm_up_min: Positive = setting(60.0, "Time constant of warming up.", unit="min")
    running_min: NonNegative = setting(
        0.0, "Time for which the arms have been running when the scan begins.", unit="min"
    )
    ageing_mm: NonNegative = setting(
        0.0, f"Displacement of bases and tools along each axis in a month, {RANDOM_WALK}."
    )
    ageing_deg: NonNegative = setting(
        0.0, "Rotation of bases and tools about each axis in a month, accumulated as a random walk."
    )
    age_months: NonNegative = setting(
        0.0, "Time since the calibration of the arms.", unit="months of 30 days"
    )
    trigger_delay_ms: Finite = size(
        "Delay from the encoders' reading to the image, while the arms move on.", signed=True
    )
    trigger_jitter_ms: Finite = size(
        "Standard deviation of that delay from view to view; both arms share it."
    )

    @property
    def sizes(self) -> tuple[float, ...]:
        """Parameters that move a tool unless they are 0."""
        return *super().sizes, (self.ageing_mm + self.ageing_deg) * self.age_months


class ArmErrors(OneArmErrors):
    """Differences between the arms and their controllers' models, drawn once per scan and arm.

    Spreads are standard deviations for each joint and axis. The controller uses its nominal model
    and the encoders. So do the plan, its clearance and the trigger.
    """

    gear_periods: int = setting(1, "Periods of the gear errors per turn of the joint.", ge=1)
    seed: int | None = setting(
        None,
        "Seed of the errors that are constant in a scan; null: the scenario's seed. It lets "
        "scans of several seeds use the same arms.",
        ge=0,
        lt=2**63,
    )
    source: OneArmErrors | None = setting(
        None, "Keys of the source arm that differ. null: as both arms."
    )
    detector: OneArmErrors | None = setting(
        None, "Keys of the detector arm that differ. null: as both arms."
    )

    @property
    def sizes(self) -> tuple[float, ...]:
        """Parameters that move a tool unless they are 0."""
        apart = (side for side in SIDES if getattr(self, side) is not None)
        return *super().sizes, *(size for side in apart for size in self.of(side).sizes)

    def of(self, side: str) -> ArmErrors:
        """Return the errors of one arm: its own keys, and those of both arms for the rest."""
        own: OneArmErrors | None = getattr(self, side)
        given = {} if own is None else {key: getattr(own, key) for key in own.model_fields_set}
        return self.model_copy(update={**given, **dict.fromkeys(SIDES)})


class ArmServo(ErrorSettings):
    """Deviation of one arm from its encoders while it moves, and after it stops."""

    resonance_hz: float = setting(
        0.0,
        "First resonance of the joints behind their encoders: accelerations bend them, and after "
        "a stop they ring down. 0: stiff joints.",
        ge=0,
        le=200,
        source="measure yours: it depends on arm, payload and pose",
    )
    damping: float = setting(
        0.03,
        "Damping ratio of that resonance.",
        gt=0,
        lt=1,
        source="0.020 to 0.036 measured: Sci. Rep. 14 (2024), 10.1038/s41598-024-61362-2, table 3",
    )
    clock_ms: Finite = setting(
        0.0, "Clock of the arm's controller behind that of the detector at the scan's beginning."
    )
    clock_ppm: Finite = setting(
        0.0, "Rate at which that clock goes slower, 1e-6 s per s.", unit="ppm"
    )

    @property
    def sizes(self) -> tuple[float, ...]:
        """Parameters that move a tool unless they are 0."""
        return self.resonance_hz, self.clock_ms, self.clock_ppm


class Servos(ErrorSettings):
    """Dynamics of each arm that its encoders do not see; sag is ``arms.windup_deg``."""

    source: ArmServo = setting(ArmServo(), "The arm with the X-ray source.")
    detector: ArmServo = setting(ArmServo(), "The arm with the panel.")

    @property
    def sizes(self) -> tuple[float, ...]:
        """Parameters that move a tool unless they are 0."""
        return *self.source.sizes, *self.detector.sizes

    def of(self, side: str) -> ArmServo:
        """Return the dynamics of one arm."""
        return self.source if side == "source" else self.detector


class ViewErrors(ErrorSettings):
    """Errors of executed poses, drawn for each view: standard deviations for each axis."""

    source_mm: Finite = size("Error of the focal spot along each axis.")
    detector_in_plane_mm: Finite = size(
        "Error of the panel along its columns and rows, which moves the piercing point."
    )
    detector_normal_mm: Finite = size("Error of the panel along its normal.")
    detector_tilt_deg: Finite = size("Rotation error of the panel about its two axes.")
    detector_turn_deg: Finite = size("Rotation error of the panel about its normal.")
    correlation_views: NonNegative = setting(
        0.0, "Correlation length of these errors in views, as for the noise of the reported poses."
    )


class PatientMotion(ErrorSettings):
    """Motion of the specimen during the scan, in directions that are drawn once per scan.

    It starts at the scenario's pose. The truth stays at that pose.
    """

    nod_mm: Finite = size(
        "Amplitude of a nod: the specimen moves this far and back, again and again."
    )
    nod_deg: Finite = size("Rotation during the nod.")
    nod_period_s: Positive = setting(20.0, "Period of the nod, in simulated time.")
    jerk_mm: Finite = size("Displacement of a sudden jerk, after which the specimen stays there.")
    jerk_deg: Finite = size("Rotation during the jerk.")
    jerk_at_s: NonNegative = setting(
        5.0, "Simulated time at which the jerk starts; it takes 0.2 s."
    )
    pivot_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Point in the world about which the specimen rotates."
    )


_OWN_SPLIT = "docs/uncertainty.md"

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "industrial": {
        "arms": {
            **{"joint_offset_deg": 0.008, "link_mm": 0.08, "link_deg": 0.005},
            **{"base_mm": 0.15, "base_deg": 0.005, "tool_mm": 0.1, "tool_deg": 0.02},
            **{"windup_deg": 0.04, "windup_spread": 0.2, "gear_deg": 0.002},
            **{"drift_mm": 0.03, "warm_up_min": 60.0, "running_min": 60.0},
        },
        "views": {
            **{"source_mm": 0.03, "detector_in_plane_mm": 0.03, "detector_normal_mm": 0.03},
            **{"detector_tilt_deg": 0.003, "detector_turn_deg": 0.003},
        },
        "encoder_step_deg": 0.0005,
    },
    "collaborative": {
        "arms": {
            **{"joint_offset_deg": 0.03, "link_mm": 0.15, "link_deg": 0.015},
            **{"base_mm": 0.4, "base_deg": 0.02, "tool_mm": 0.4, "tool_deg": 0.1},
            **{"windup_deg": 0.1, "windup_spread": 0.2, "gear_deg": 0.01},
            **{"drift_mm": 0.05, "warm_up_min": 45.0, "running_min": 30.0},
            **{"trigger_jitter_ms": 0.2},
        },
        "views": {
            **{"source_mm": 0.05, "detector_in_plane_mm": 0.05, "detector_normal_mm": 0.05},
            **{"detector_tilt_deg": 0.005, "detector_turn_deg": 0.005},
        },
        "encoder_step_deg": 0.002,
    },
    "c_arm": {
        "views": {
            **{"source_mm": 0.25, "detector_in_plane_mm": 0.16, "detector_normal_mm": 0.25},
            **{"detector_tilt_deg": 0.02, "detector_turn_deg": 0.02},
        },
    },
    "c_arm_uncalibrated": {
        "views": {
            **{"source_mm": 3.5, "detector_in_plane_mm": 6.4, "detector_normal_mm": 3.5},
            **{"detector_tilt_deg": 1.2, "detector_turn_deg": 0.4, "correlation_views": 40.0},
        },
    },
}
"""Keys of this section, by kind of machine.

Repeatability and absolute error are typical of such arms: 0.03 to 0.05 mm (data sheets, ISO 9283)
and 0.5 to 2 mm before calibration. How the absolute error is shared among the terms is our choice.
The values of the C-arm are its short-term reproducibility, and half of the largest deviations from
the mean orbit, as reported by Daly et al. (2008).
"""


class Uncertainty(Extensible):
    """Differences between commanded, executed and believed poses."""

    preset: Literal["industrial", "collaborative", "c_arm", "c_arm_uncalibrated"] | None = setting(
        None,
        "Typical errors of a kind of machine; keys that are set here take precedence.",
        source=f"{_OWN_SPLIT}; c_arm: {DALY}",
    )
    arms: ArmErrors = setting(
        ArmErrors(), "Differences between the arms and their nominal models.", read_by="executed"
    )
    servos: Servos = setting(
        Servos(), "Vibration of the joints, and clocks that differ.", read_by="executed"
    )
    views: ViewErrors = setting(
        ViewErrors(), "Errors that differ from view to view.", read_by="executed"
    )
    patient: PatientMotion = setting(PatientMotion(), "Motion of the specimen.", read_by="executed")
    encoder_step_deg: NonNegative = setting(
        0.0, "Resolution of the joint encoders.", read_by="believed"
    )
    calibration: Path | None = setting(
        None,
        "File of calibrated arms (twinct calibrate kinematics), which turn encoder "
        "readings into believed poses. null: the nominal arms do.",
        read_by="believed",
    )
    source: PoseNoise = setting(
        PoseNoise(), "Noise of the reported source poses.", source="the paper", read_by="believed"
    )
    detector: PoseNoise = setting(
        PoseNoise(), "Noise of the reported panel poses.", source="the paper", read_by="believed"
    )
    seed: int | None = setting(
        None,
        "Seed of the reported poses' noise alone; null: the scenario's seed. Other seeds give "
        "other believed poses for the same images.",
        ge=0,
        lt=2**63,
        read_by="believed",
    )

    @classmethod
    def extension_keys(cls) -> Mapping[str, tuple[Any, FieldInfo]]:
        """Return a key for each error term of another package."""
        return {name: _key(term) for name, term in error_terms().items()}

    @model_validator(mode="after")
    def _preset_gives_way(self) -> Uncertainty:
        for name, under in PRESETS[self.preset].items() if self.preset else ():
            if isinstance(under, Mapping):
                section: Section = getattr(self, name)
                keys = cast("Mapping[str, float]", under)
                left = {key: keys[key] for key in keys if key not in section.model_fields_set}
                object.__setattr__(self, name, section.model_copy(update=left))
            elif name not in self.model_fields_set:
                object.__setattr__(self, name, under)
        # What the scenario stores is complete, whatever is read with it later.
        arms, keys = self.arms, OneArmErrors.model_fields
        own = {
            side: OneArmErrors(**{key: getattr(arms.of(side), key) for key in keys})
            for side in SIDES
            if getattr(arms, side) is not None
        }
        if own:
            object.__setattr__(self, "arms", arms.model_copy(update=own))
        return self

    @property
    def moves(self) -> bool:
        """True if executed poses can differ from the poses that the controllers assume."""
        sections = (getattr(self, name) for name in type(self).model_fields)
        return any(any(one.sizes) for one in sections if isinstance(one, ErrorSettings))

    @property
    def of_arms(self) -> tuple[str, ...]:
        """Keys with an effect that only arms can have."""
        given = {
            "arms": any(self.arms.sizes),
            "servos": any(self.servos.sizes),
            "encoder_step_deg": self.encoder_step_deg > 0,
            "calibration": self.calibration is not None,
        }
        for name, term in error_terms().items():
            own: ErrorSettings | None = getattr(self, name)
            given[name] = own is not None and any(own.sizes) and "pose" not in term.places
        return tuple(name for name, has in given.items() if has)

    @model_serializer(mode="wrap")
    def _without_unused_extensions(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out foreign errors that are not used: others can read the scenario."""
        return {
            name: value
            for name, value in plain(self).items()
            if value is not None or name not in error_terms()
        }


@cache
def error_terms() -> Registry[ErrorTerm]:
    """Return the error terms of other packages; they are looked up once per process."""
    known = Registry("twinct.errors", ErrorTerm, {}, taken=_OWN)
    known.keep(_fits, "the settings of {name}")
    return known


_OWN = frozenset(Uncertainty.model_fields)
"""Keys that no error term of another package may take."""


def _key(term: ErrorTerm) -> tuple[Any, FieldInfo]:
    description = f"{inspect.cleandoc(term.settings.__doc__ or term.name)} null: no such error."
    return term.settings | None, setting(None, description, read_by="executed")


def _fits(term: ErrorTerm) -> None:
    if term.section:
        raise ValueError("an error term of another package has a section of its own")
    require_usable(term.name, term.settings, Uncertainty)
