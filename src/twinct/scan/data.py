"""A scan: the images of all views, and the three geometries as separate data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.extras import optional
from twinct.core.files.pictures import show
from twinct.core.foreign_text import counted, quoted
from twinct.geometry import Pose, ScanGeometry
from twinct.geometry.wire import PosePairs, Reached
from twinct.recon.few_photons import integrals_of_photons
from twinct.scan.encoder_model import nominal_poses, relative_to_specimen
from twinct.scan.integrals import line_integrals
from twinct.scan.named_geometries import OWN, RELATIVE, NamedGeometry, poses_digest
from twinct.scenario import Scenario, Uncertainty
from twinct.uncertainty import reported_poses

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.xray.chain import ViewImages
    from twinct.xray.photons import FreePhotons


@dataclass(frozen=True, eq=False)
class View:
    """One stored view, as observers receive it.

    Attributes:
        transmission: I/I0, (rows, columns).
        reached: state of the robots.
        frames: images behind the transmission, if ``detector.keep`` requests them.
    """

    transmission: NDArray[np.float32]
    reached: Reached
    frames: ViewImages | None = None

    def frozen(self) -> View:
        """Return a copy whose image is read-only."""
        image = self.transmission.view()
        image.flags.writeable = False
        return replace(self, transmission=image)


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
class Scan:
    """All views of a scan.

    The images were rendered from ``executed``; the trajectory requested ``commanded``. Believed
    poses are derived from a scan, by one or several methods, and are never part of the scan.

    Attributes:
        scenario: the scanned scenario; its uncertainty section determines ``believed``.
        transmission: I/I0, (views, rows, columns), float32.
        executed_object: ``world_from_object`` of each view.
        joint_names: source arm first.
        joints: joint positions, (views, joints), rad.
        simulated_s: simulated time at exposure, (views,).
        clearance_mm: smallest gap on the way to each view, (views,).
        exposure: instants of each view's exposure; empty for instantaneous exposures.
        derived: other geometries of these views, by name.
        bad_pixels: pixels replaced by their neighbours' mean, (rows, columns); None if none are.
        mas: tube load of each view, (views,), mAs; None if all have the scenario's ``source.mas``.
        acquired: what ``save`` writes besides; None unless the scan is from ``from_views``.
    """

    scenario: Scenario
    transmission: NDArray[np.float32]
    commanded: PosePairs
    executed: PosePairs
    executed_object: tuple[Pose, ...]
    joint_names: tuple[str, ...]
    joints: NDArray[np.float64]
    simulated_s: NDArray[np.float64]
    clearance_mm: NDArray[np.float64]
    exposure: tuple[PosePairs, ...] = ()
    derived: Mapping[str, NamedGeometry] = field(default_factory=dict[str, NamedGeometry])
    bad_pixels: NDArray[np.bool_] | None = None
    mas: NDArray[np.float64] | None = None
    acquired: Acquired | None = None

    def __post_init__(self) -> None:
        """Check that all derived geometries belong to this scan.

        Raises:
            InputError: a geometry does not; it is named.
        """
        own = {"views": len(self), "executed": poses_digest(self.executed)} if self.derived else {}
        for name, poses in self.derived.items():
            its = {"views": len(poses.poses), "executed": poses.made_by.get("executed")}
            if its["views"] != own["views"] or its["executed"] not in (None, own["executed"]):
                raise InputError(
                    f"geometry {quoted(name)} was derived from another scan: it has "
                    f"{its['views']} views "
                    f"made for executed poses {str(its['executed'])[:12]}; this scan has "
                    f"{own['views']} views and executed poses {str(own['executed'])[:12]}"
                )

    @cached_property
    def believed(self) -> PosePairs:
        """Poses that the robots report, given the scenario's uncertainty."""
        return _with_noise(self.nominal, self.scenario)

    @cached_property
    def reported(self) -> NamedGeometry:
        """Believed poses, with their model and settings."""
        return NamedGeometry("believed", self.believed, _made_by(self.scenario, self.executed))

    @cached_property
    def nominal(self) -> PosePairs:
        """Source and panel poses that the controllers compute from encoders and nominal model.

        Equal to ``executed`` if the controllers' model has no errors.
        """
        return nominal_poses(self.scenario, self.commanded, self.executed, self.joints)

    @property
    def stands(self) -> Pose:
        """``world_from_object`` of the ground truth, where a moving specimen starts."""
        if any(self.scenario.uncertainty.patient.sizes):
            return self.scenario.specimen.world_from_specimen
        return self.executed_object[len(self) // 2]  # all views agree, except for rounding

    @cached_property
    def relative(self) -> PosePairs:
        """Executed poses relative to the specimen; equal to ``executed`` if it does not move."""
        if not any(self.scenario.uncertainty.patient.sizes):
            return self.executed
        return relative_to_specimen(self.stands, self.executed_object, self.executed)

    @property
    def middle_s(self) -> NDArray[np.float64]:
        """Simulated time of each view at the middle of its exposure, (views,), to a time step."""
        source, arms = self.scenario.source, self.scenario.cell.kind == "arms"
        late = source.exposure_ms / 2000 if arms and source.motion_samples > 1 else 0.0
        return self.simulated_s - late

    @property
    def exposures_rel(self) -> NDArray[np.float64] | None:
        """Tube load of each view, relative to ``source.mas``, (views,); None if all are 1."""
        return None if self.mas is None else self.mas / self.scenario.source.mas

    @classmethod
    def from_views(
        cls,
        scenario: Scenario,
        commanded: PosePairs,
        images: Sequence[NDArray[np.float32]],
        reached: Sequence[Reached],
        mas: NDArray[np.float64] | None = None,
        plan: MotionPlan | None = None,
    ) -> Scan:
        """Build from the transmissions and states of views that were acquired one by one."""
        executed = PosePairs.joined(r.executed for r in reached)
        transmission = np.stack(images)
        return cls(
            scenario=scenario,
            transmission=transmission,
            commanded=commanded,
            executed=PosePairs(executed.source, executed.detector),
            executed_object=executed.object,
            joint_names=reached[0].joint_names,
            joints=np.stack([r.position for r in reached]),
            simulated_s=np.array([r.time_s for r in reached]),
            clearance_mm=np.array([r.clearance_mm for r in reached]),
            exposure=tuple(r.exposure for r in reached) if reached[0].exposure else (),
            bad_pixels=bad_pixels_of(scenario),
            mas=mas,
            acquired=Acquired(tuple(reached), transmission, plan),
        )

    def save(self, path: str | Path) -> None:
        """Write the scan as a store, as a run does; ``load_scan`` reads it.

        ``twinct verify`` and ``twinct export`` take it, and in a folder of its own a run resumes
        with it, unless its images were changed. Meshes and views that the scenario took from memory
        go to the folder ``inputs`` beside it. Derived geometries are no part of it.

        Args:
            path: path of the store, such as ``out/mine/scan.zarr``; it appears when it is complete.

        Raises:
            InputError: the scan was loaded or put together, or its scenario has ``detector.keep``:
                joint speeds, torques, states of the simulation or images are unknown.
            ScanExistsError: the path exists.
            StorageError: the store cannot be written.
        """
        from twinct import scan

        scan.save_scan(self, Path(path))

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.transmission)

    def __repr__(self) -> str:
        """Return a one-line summary without arrays and poses."""
        rows, columns = self.transmission.shape[1:]
        size = f"{counted(len(self), 'view')}, {columns} x {rows} px"
        return f"Scan({quoted(self.scenario.name)}, {size})"

    def poses(self, which: str) -> PosePairs:
        """Return the poses of ``commanded``, ``executed``, ``believed`` or a derived geometry.

        Also of ``relative``: executed poses relative to the specimen.

        Raises:
            InputError: no geometry has this name.
        """
        if which in (*OWN, RELATIVE):
            return cast(PosePairs, getattr(self, which))
        if which not in self.derived:
            known = ", ".join(dict.fromkeys((*OWN, *self.derived)))
            raise InputError(f"unknown geometry {quoted(which)}; choose from {known}")
        return self.derived[which].poses

    def geometry(self, which: str = "believed") -> ScanGeometry:
        """Return the geometry of a set of poses with the scenario's panel; see ``poses``.

        Raises:
            InputError: there is no geometry of this name, or its poses form none.
        """
        return self.poses(which).geometry(self.scenario.detector.panel)

    def line_integrals(self) -> NDArray[np.float32]:
        """Return -ln(I/I0) of all images, (views, rows, columns), float32.

        If the scenario states the noise, few photons do not bias it (``integrals_of_photons``).
        """
        if (photons := self._photons) is None:
            return line_integrals(self.transmission)
        return integrals_of_photons(self.transmission, photons.single * self._loads)

    @property
    def photons(self) -> NDArray[np.float64] | None:
        """Photons of a pixel in the free beam, by view, (views,); None if no noise is stated.

        It is the number of equal photons that has the noise of many pixels together.
        """
        return None if self._photons is None else self._photons.number * self._loads

    @property
    def _loads(self) -> NDArray[np.float64]:
        return np.ones(len(self)) if self.exposures_rel is None else self.exposures_rel

    @cached_property
    def _photons(self) -> FreePhotons | None:
        from twinct.xray.photons import free_photons  # loads the X-ray chain

        detector = self.scenario.detector
        if detector.noise is None or self.scenario.specimen.unknown:
            return None
        return free_photons(
            self.scenario.source, detector, self.commanded.geometry(detector.panel)[:1]
        )

    def to_xarray(self, which: str = "believed") -> Any:
        """Return a labelled view of the scan, an ``xarray.Dataset`` that shares the images' memory.

        Its variables are transmission (view, row, column), joints (view, joint), time and clearance
        (view), and of one geometry source, detector, u and v (view, axis). Columns and rows are in
        mm from the middle of the panel.

        Args:
            which: name of the geometry, see ``poses``.

        Raises:
            InputError: xarray is not installed, or there is no geometry of this name.
        """
        xarray = optional("xarray", "Scan.to_xarray")
        geometry, panel = self.geometry(which), self.scenario.detector.panel
        rows, columns = (np.arange(n) - (n - 1) / 2 for n in panel.shape)
        mm = {"units": "mm"}
        vectors = {"source": mm, "detector": mm, "u": {}, "v": {}}
        return xarray.Dataset(
            {
                "transmission": (("view", "row", "column"), self.transmission),
                "joints": (("view", "joint"), self.joints, {"units": "rad"}),
                "simulated": ("view", self.simulated_s, {"units": "s"}),
                "clearance": ("view", self.clearance_mm, mm),
                **{
                    name: (("view", "axis"), getattr(geometry, name), attributes)
                    for name, attributes in vectors.items()
                },
            },
            coords={
                "view": np.arange(len(self)),
                "row": ("row", rows * panel.pitch_v, mm),
                "column": ("column", columns * panel.pitch_u, mm),
                "axis": list("xyz"),
                "joint": np.array(self.joint_names, dtype=np.str_),
            },
            attrs={"scenario": self.scenario.name, "geometry": which},
        )

    def show(self, path: str | Path | None = None, views: Sequence[int] | None = None) -> None:
        """Show projections as line integrals in one grey window, seen from the source.

        Args:
            path: file for the picture, such as ``scan.png``; None opens a window, or shows it in
                the notebook.
            views: which ones, at most 12; four spread over the scan if not given.

        Raises:
            InputError: there is no such view; no path is given, and there is no window.
        """
        shown = np.linspace(0, len(self) - 1, min(4, len(self))).round() if views is None else views
        chosen = [int(view) for view in shown]
        if not 1 <= len(chosen) <= MOST_SHOWN or not all(0 <= v < len(self) for v in chosen):
            raise InputError(
                f"views {chosen}: choose 1 to {MOST_SHOWN} of the views 0 to {len(self) - 1}"
            )
        panel = self.scenario.detector.panel
        images = line_integrals(self.transmission[chosen])
        columns = min(4, len(chosen))
        rows = -(-len(chosen) // columns)
        width, height = panel.size_mm
        size = 10.4, rows * (2.4 * height / width + 0.4) + 0.3
        show(partial(_draw, chosen, images, (rows, columns), (width, height)), size, path)


MOST_SHOWN = 12
"""Largest number of projections in one picture."""


def _draw(
    views: Sequence[int],
    images: NDArray[np.float32],
    grid: tuple[int, int],
    size_mm: tuple[float, float],
    figure: Any,
) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    norm = Normalize(0, max(float(np.percentile(images, 99.9)), 1e-6))
    width, height = size_mm
    extent = (-width / 2, width / 2, -height / 2, height / 2)
    everywhere = figure.subplots(*grid, squeeze=False, sharex=True, sharey=True)
    for axes in everywhere.flat[len(views) :]:
        axes.set_visible(False)
    for axes, view, image in zip(everywhere.flat, views, images, strict=False):
        axes.imshow(image, cmap="gray", norm=norm, origin="lower", extent=extent)
        axes.set(title=f"view {view}", xlabel="u / mm", ylabel="v / mm")
        axes.label_outer()
    figure.colorbar(ScalarMappable(norm, "gray"), ax=everywhere, label="line integral, −ln(I / I₀)")


def bad_pixels_of(scenario: Scenario) -> NDArray[np.bool_] | None:
    """Return a scenario's map of bad pixels, (rows, columns); None if it has none.

    Raises:
        InputError: the file with the map is unusable.
    """
    if scenario.detector.bad_pixels is None:
        return None
    from twinct.xray.build import build_bad_pixels

    return build_bad_pixels(scenario.detector, scenario.seed)


def reported(
    scenario: Scenario,
    joints: NDArray[np.float64],
    executed: PosePairs,
    commanded: PosePairs,
    name: str = "believed",
) -> NamedGeometry:
    """Return the poses that the robots report, given the scenario's uncertainty."""
    nominal = nominal_poses(scenario, commanded, executed, joints)
    return NamedGeometry(name, _with_noise(nominal, scenario), _made_by(scenario, executed))


def _with_noise(nominal: PosePairs, scenario: Scenario) -> PosePairs:
    return reported_poses(nominal, scenario.uncertainty, scenario.believed_seed)


def _made_by(scenario: Scenario, executed: PosePairs) -> dict[str, Any]:
    """Return the model and the settings behind the believed poses of executed ones."""
    uncertainty = scenario.uncertainty
    model = "nominal kinematics" if uncertainty.moves else "repeatability"
    model = "calibrated kinematics" if uncertainty.calibration else model
    made_by = {"model": model, **_noise_settings(uncertainty), "seed": scenario.believed_seed}
    return made_by | {"executed": poses_digest(executed)}


def _noise_settings(uncertainty: Uncertainty) -> dict[str, Any]:
    """Return the settings behind the reported poses, without newer keys at their default."""
    data = uncertainty.model_dump(mode="json", exclude_defaults=True)
    for side in ("source", "detector"):
        always = getattr(uncertainty, side).model_dump(include={"sigma_mm", "cutoff_mm"})
        data[side] = always | data.get(side, {})
    return data
