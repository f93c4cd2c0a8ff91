"""Provenance of a scan: who took its images, at which poses, and with which settings.

Nothing else in twinct asks whether a scan was simulated or imported: it asks for what it needs,
such as a geometry or the photons, and the provenance has it or says that it is not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.scan.encoder_model import EncoderModel, relative_to_specimen
from twinct.scan.named_geometries import OWN, NamedGeometry, poses_digest
from twinct.scenario import Scenario, Uncertainty, stage_digests
from twinct.scenario.imported import STATED, ImportedSettings, ScanSettings
from twinct.uncertainty import reported_poses
from twinct.xray.sections.detector import SnrNoise

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.xray.photons import FreePhotons

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Acquired:
    """Data of an acquisition that a store holds besides a scan's own fields.

    Attributes:
        reached: state of the robots in each view.
        transmission: the scan's images; others in their place are not those of its scenario.
        plan: plan that the arms followed, if any.
    """

    reached: tuple[Reached, ...]
    transmission: NDArray[np.float32]
    plan: MotionPlan | None


@dataclass(frozen=True, eq=False)
class Simulated:
    """A scan of a scenario, which states all of it.

    The images were rendered from ``executed``; the trajectory requested ``commanded``. Believed
    poses are derived from both, and never stored.

    Attributes:
        scenario: the scanned scenario; its uncertainty section determines the believed poses.
        commanded: commanded poses.
        executed: poses at exposure.
        executed_object: ``world_from_object`` of each view.
        joint_names: source arm first.
        joints: joint positions, (views, joints), rad.
        simulated_s: simulated time at exposure, (views,).
        clearance_mm: smallest gap on the way to each view, (views,).
        exposure: instants of each view's exposure; empty for instantaneous exposures.
        acquired: what ``Scan.save`` writes besides; None unless the scan was just taken.
    """

    kind: ClassVar[str] = "simulated"
    own: ClassVar[tuple[str, ...]] = OWN
    """Names of the geometries that the scan came with, the first one known beforehand."""
    kept: ClassVar[str] = "executed"
    """Name of the stored geometry that is nearest to the truth."""

    scenario: Scenario
    commanded: PosePairs
    executed: PosePairs
    executed_object: tuple[Pose, ...]
    joint_names: tuple[str, ...]
    joints: Floats
    simulated_s: Floats
    clearance_mm: Floats
    exposure: tuple[PosePairs, ...] = ()
    acquired: Acquired | None = None

    @property
    def settings(self) -> Scenario:
        """Settings of beam, panel and reconstruction: the scenario."""
        return self.scenario

    def poses(self, name: str) -> PosePairs | None:
        """Return the poses of an own geometry, or ``relative``; None for another name."""
        match name:
            case "commanded":
                return self.commanded
            case "executed":
                return self.executed
            case "believed":
                return self.reported.poses
            case "relative":
                return self.taken
            case _:
                return None

    @cached_property
    def reported(self) -> NamedGeometry:
        """Believed poses, with their model and settings."""
        return self.reported_as("believed")

    def reported_as(self, name: str) -> NamedGeometry:
        """Return the believed poses as a geometry with a name."""
        uncertainty, seed = self.scenario.uncertainty, self.scenario.believed_seed
        model = "nominal kinematics" if uncertainty.moves else "repeatability"
        model = "calibrated kinematics" if uncertainty.calibration else model
        made_by = {"model": model, **_noise_settings(uncertainty), "seed": seed}
        made_by["executed"] = poses_digest(self.executed)
        return NamedGeometry(name, reported_poses(self.nominal, uncertainty, seed), made_by)

    @cached_property
    def encoders(self) -> EncoderModel:
        """The controllers' model of the arms."""
        scenario = self.scenario
        return EncoderModel(scenario.cell, scenario.detector.panel, scenario.uncertainty)

    @cached_property
    def nominal(self) -> PosePairs:
        """Source and panel poses that the controllers compute from encoders and nominal model.

        Equal to ``executed`` if the controllers' model has no errors.
        """
        return self.encoders.nominal_poses(self.commanded, self.executed, self.joints)

    @property
    def stands(self) -> Pose:
        """``world_from_object`` of the ground truth, where a moving specimen starts."""
        if any(self.scenario.uncertainty.patient.sizes):
            return self.scenario.specimen.world_from_specimen
        return self.executed_object[len(self.simulated_s) // 2]  # all agree, except for rounding

    @cached_property
    def taken(self) -> PosePairs:
        """Executed poses relative to the specimen; equal to ``executed`` if it does not move."""
        if not any(self.scenario.uncertainty.patient.sizes):
            return self.executed
        return relative_to_specimen(self.stands, self.executed_object, self.executed)

    @property
    def made_for(self) -> Mapping[str, str]:
        """Name and digest of the poses that identify the scan in geometries derived from it."""
        return {"executed": poses_digest(self.executed)}

    @cached_property
    def free_photons(self) -> FreePhotons | None:
        """Photons of a pixel in the free beam; None if no noise is stated."""
        from twinct.xray.photons import free_photons  # loads the X-ray chain

        source, detector = self.scenario.source, self.scenario.detector
        if detector.noise is None:
            return None
        return free_photons(source, detector, self.commanded.geometry(detector.panel)[:1])

    @property
    def first(self) -> PosePairs:
        """Poses that were known before any image was taken."""
        return self.commanded

    @property
    def noiseless(self) -> bool:
        """True if the images are known to have no noise."""
        return self.scenario.detector.noise is None

    @property
    def middle_s(self) -> Floats:
        """Simulated time of each view at the middle of its exposure, to a time step."""
        source, arms = self.scenario.source, self.scenario.cell.kind == "arms"
        late = source.exposure_ms / 2000 if arms and source.motion_samples > 1 else 0.0
        return self.simulated_s - late

    def labelled(self) -> dict[str, tuple[Any, ...]]:
        """Return what else is known of each view: axes, values and units by name, for xarray."""
        return {
            "joints": (("view", "joint"), self.joints, {"units": "rad"}),
            "simulated": ("view", self.simulated_s, {"units": "s"}),
            "clearance": ("view", self.clearance_mm, {"units": "mm"}),
        }

    def volume_digest(self, images: str) -> str:
        """Return the SHA-256 of all that a volume depends on, except for derived geometries.

        Args:
            images: digest of the images, which follow from the scenario here.
        """
        return stage_digests(self.scenario)["volume"]

    def with_settings(self, settings: ScanSettings) -> Self:
        """Return the provenance with another scenario.

        Raises:
            TypeError: the settings are no scenario.
        """
        if not isinstance(settings, Scenario):
            raise TypeError("a simulated scan needs a whole scenario")
        return replace(self, scenario=settings)

    def of_views(self, views: Sequence[int]) -> Self:
        """Return the provenance of some views."""
        chosen = list(views)
        return replace(
            self,
            commanded=_some(self.commanded, chosen),
            executed=_some(self.executed, chosen),
            executed_object=tuple(self.executed_object[v] for v in chosen),
            joints=self.joints[chosen],
            simulated_s=self.simulated_s[chosen],
            clearance_mm=self.clearance_mm[chosen],
            exposure=tuple(self.exposure[v] for v in chosen) if self.exposure else (),
            acquired=None,
        )


@dataclass(frozen=True, eq=False)
class Recorded(Simulated):
    """A scan by real arms: their joints and images, and the user's scenario of the room.

    Executed poses are those of the kinematics at the joints that the drivers reported.
    """

    kind: ClassVar[str] = "recorded"


@dataclass(frozen=True, eq=False)
class Imported:
    """A scan from files of another machine, with one geometry, which they state.

    Attributes:
        settings: what is known of the scan besides its images and its geometry.
        stated: the poses that the files state.
        files: names of the files.
    """

    kind: ClassVar[str] = "imported"
    own: ClassVar[tuple[str, ...]] = (STATED,)
    kept: ClassVar[str] = STATED

    settings: ImportedSettings
    stated: PosePairs
    files: tuple[str, ...] = ()

    def poses(self, name: str) -> PosePairs | None:
        """Return the stated poses; None for another name."""
        return self.stated if name == STATED else None

    @property
    def reported(self) -> NamedGeometry:
        """The stated geometry."""
        return NamedGeometry(STATED, self.stated, {"model": STATED, **self.made_for})

    @property
    def first(self) -> PosePairs:
        """The stated poses."""
        return self.stated

    @property
    def taken(self) -> PosePairs:
        """The stated poses: nobody knows better ones."""
        return self.stated

    @property
    def made_for(self) -> Mapping[str, str]:
        """Name and digest of the poses that identify the scan in geometries derived from it."""
        return {STATED: poses_digest(self.stated)}

    @cached_property
    def free_photons(self) -> FreePhotons | None:
        """Photons of a pixel in the free beam; None if neither stated nor measured."""
        from twinct.xray.photons import FreePhotons  # loads the X-ray chain

        noise = self.settings.detector.noise
        return FreePhotons.of_snr(noise) if isinstance(noise, SnrNoise) else None

    @property
    def noiseless(self) -> bool:
        """False: every image of a machine has noise."""
        return False

    @property
    def middle_s(self) -> Floats:
        """Empty: the times are not known."""
        return np.zeros(0)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """None: arms are not known."""
        return ()

    def labelled(self) -> dict[str, tuple[Any, ...]]:
        """Return nothing: neither joints nor times are known."""
        return {}

    def volume_digest(self, images: str) -> str:
        """Return the SHA-256 of all that a volume depends on, except for derived geometries.

        Args:
            images: digest of the images.
        """
        return self.settings.volume_digest(images)

    def with_settings(self, settings: ScanSettings) -> Self:
        """Return the provenance with other settings.

        Raises:
            TypeError: the settings are a scenario.
        """
        if not isinstance(settings, ImportedSettings):
            raise TypeError("an imported scan has no scenario")
        return replace(self, settings=settings)

    def of_views(self, views: Sequence[int]) -> Self:
        """Return the provenance of some views."""
        return replace(self, stated=_some(self.stated, views))


Provenance = Simulated | Imported
"""Who took the images of a scan, at which poses, and with which settings."""


def simulated(provenance: Provenance) -> Simulated:
    """Return the provenance of a scan of a scenario, which some work needs.

    Raises:
        InputError: the scan was imported.
    """
    if isinstance(provenance, Simulated):
        return provenance
    raise InputError(_without_scenario(provenance.settings))


def scenario_in(settings: ScanSettings) -> Scenario:
    """Return the settings of a scan as the scenario that some work needs.

    Raises:
        InputError: the scan was imported.
    """
    if isinstance(settings, Scenario):
        return settings
    raise InputError(_without_scenario(settings))


def _without_scenario(settings: ScanSettings) -> str:
    return (
        f"{quoted(settings.name)} is an imported scan: it has no scenario, no known object and no "
        "poses but the stated ones, so it cannot be simulated and has no truth; 'twinct "
        "reconstruct' makes and judges its volumes"
    )


def _some(poses: PosePairs, views: Sequence[int]) -> PosePairs:
    return PosePairs(tuple(poses.source[v] for v in views), tuple(poses.detector[v] for v in views))


def _noise_settings(uncertainty: Uncertainty) -> dict[str, Any]:
    """Return the settings behind the reported poses, without newer keys at their default."""
    data = uncertainty.model_dump(mode="json", exclude_defaults=True)
    for side in ("source", "detector"):
        always = getattr(uncertainty, side).model_dump(include={"sigma_mm", "cutoff_mm"})
        data[side] = always | data.get(side, {})
    return data
