"""A scan: the images of all views, their geometries as separate data, and where they are from."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import optional
from twinct.core.files.pictures import show
from twinct.core.foreign_text import counted, quoted
from twinct.geometry import Pose, ScanGeometry
from twinct.geometry.wire import PosePairs, Reached
from twinct.recon.few_photons import integrals_of_photons
from twinct.scan.integrals import line_integrals
from twinct.scan.named_geometries import NamedGeometry
from twinct.scan.provenance import Acquired, Provenance, Simulated, simulated
from twinct.scenario import Detector, Scenario
from twinct.scenario.imported import ScanSettings

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.xray.chain import ViewImages


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
class Scan:
    """Projections of a scan, with the geometries that exist of it.

    The provenance knows who took the images, with which settings and at which poses. The fields of
    a simulation, such as ``executed`` or ``joints``, are read through the scan, too.

    Attributes:
        provenance: where the images are from.
        transmission: I/I0, (views, rows, columns), float32.
        derived: geometries derived from the scan, by name.
        bad_pixels: pixels replaced by their neighbours' mean, (rows, columns); None if none are.
        mas: tube load of each view, (views,), mAs; None if all have the scenario's ``source.mas``.
    """

    provenance: Provenance
    transmission: NDArray[np.float32]
    derived: Mapping[str, NamedGeometry] = field(default_factory=dict[str, NamedGeometry])
    bad_pixels: NDArray[np.bool_] | None = None
    mas: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Check that all derived geometries belong to this scan.

        Raises:
            InputError: a geometry does not; it is named.
        """
        if not self.derived:
            return
        ((which, own),) = self.provenance.made_for.items()
        for name, geometry in self.derived.items():
            views = len(geometry.poses)
            # Earlier versions called the stated poses of an imported scan executed.
            its = geometry.made_by.get(which, geometry.made_by.get("executed"))
            if views != len(self) or its not in (None, own):
                raise InputError(
                    f"geometry {quoted(name)} was derived from another scan: it has {views} views "
                    f"made for {which} poses {str(its)[:12]}; this scan has {len(self)} views and "
                    f"{which} poses {own[:12]}"
                )

    @property
    def settings(self) -> ScanSettings:
        """Settings of beam, panel and reconstruction, as far as they are known."""
        return self.provenance.settings

    @property
    def simulated(self) -> Simulated:
        """The simulation or recording that a scenario describes.

        Raises:
            InputError: the scan was imported.
        """
        return simulated(self.provenance)

    @property
    def scenario(self) -> Scenario:
        """The scanned scenario; an imported scan has none."""
        return self.simulated.scenario

    @property
    def commanded(self) -> PosePairs:
        """Poses that the trajectory requested; an imported scan has none."""
        return self.simulated.commanded

    @property
    def executed(self) -> PosePairs:
        """Poses at exposure; an imported scan has none."""
        return self.simulated.executed

    @property
    def joints(self) -> NDArray[np.float64]:
        """Joint positions, (views, joints), rad; an imported scan has none."""
        return self.simulated.joints

    @property
    def simulated_s(self) -> NDArray[np.float64]:
        """Simulated time at exposure, (views,); an imported scan has none."""
        return self.simulated.simulated_s

    @property
    def clearance_mm(self) -> NDArray[np.float64]:
        """Smallest gap on the way to each view, (views,); an imported scan has none."""
        return self.simulated.clearance_mm

    @property
    def middle_s(self) -> NDArray[np.float64]:
        """Time of each view at the middle of its exposure, (views,), s; empty if not known."""
        return self.provenance.middle_s

    @property
    def stands(self) -> Pose:
        """``world_from_object`` of the ground truth; an imported scan has none."""
        return self.simulated.stands

    @property
    def reported(self) -> NamedGeometry:
        """Geometry that the machine reports: the believed or, of an imported scan, stated one."""
        return self.provenance.reported

    @property
    def believed(self) -> PosePairs:
        """Poses that the machine reports."""
        return self.reported.poses

    @property
    def relative(self) -> PosePairs:
        """Poses at which the images were taken, relative to the object, as far as known."""
        return self.provenance.taken

    @property
    def geometries(self) -> tuple[str, ...]:
        """Names of all geometries of the scan."""
        return tuple(dict.fromkeys((*self.provenance.own, *self.derived)))

    @property
    def exposures_rel(self) -> NDArray[np.float64] | None:
        """Tube load of each view, relative to ``source.mas``, (views,); None if all are 1."""
        return None if self.mas is None else self.mas / self.scenario.source.mas

    def with_settings(self, settings: ScanSettings) -> Scan:
        """Return the scan with other settings, such as of its reconstruction.

        Raises:
            TypeError: a simulated scan needs a scenario, an imported one has none.
        """
        return replace(self, provenance=self.provenance.with_settings(settings))

    @kinds_checked
    def of_views(self, views: Sequence[int]) -> Scan:
        """Return the scan of some views, without derived geometries."""
        chosen = list(views)
        return replace(
            self,
            provenance=self.provenance.of_views(chosen),
            transmission=self.transmission[chosen],
            derived={},
            mas=None if self.mas is None else self.mas[chosen],
        )

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
        provenance = Simulated(
            scenario=scenario,
            commanded=commanded,
            executed=PosePairs(executed.source, executed.detector),
            executed_object=executed.object,
            joint_names=reached[0].joint_names,
            joints=np.stack([r.position for r in reached]),
            simulated_s=np.array([r.time_s for r in reached]),
            clearance_mm=np.array([r.clearance_mm for r in reached]),
            exposure=tuple(r.exposure for r in reached) if reached[0].exposure else (),
            acquired=Acquired(tuple(reached), transmission, plan),
        )
        bad_pixels = bad_pixels_of(scenario.detector, scenario.seed)
        return cls(provenance, transmission, bad_pixels=bad_pixels, mas=mas)

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
        return f"Scan({quoted(self.settings.name)}, {size})"

    def poses(self, which: str) -> PosePairs:
        """Return the poses of a geometry by its name, one of ``geometries``.

        Those of a simulated scan also have ``relative``: executed poses relative to the specimen.

        Raises:
            InputError: no geometry has this name.
        """
        if (own := self.provenance.poses(which)) is not None:
            return own
        if which not in self.derived:
            known = ", ".join(self.geometries)
            raise InputError(f"unknown geometry {quoted(which)}; choose from {known}")
        return self.derived[which].poses

    def geometry(self, which: str | None = None) -> ScanGeometry:
        """Return the geometry of a set of poses with the scan's panel.

        Args:
            which: name of the geometry; None: the one that the machine reports.

        Raises:
            InputError: there is no geometry of this name, or its poses form none.
        """
        poses = self.poses(which or self.reported.name)
        return poses.geometry(self.settings.detector.panel)

    def line_integrals(self) -> NDArray[np.float32]:
        """Return -ln(I/I0) of all images, (views, rows, columns), float32.

        If the scenario states the noise, few photons do not bias it (``integrals_of_photons``).
        """
        if (photons := self.provenance.free_photons) is None:
            return line_integrals(self.transmission)
        return integrals_of_photons(self.transmission, photons.single * self._loads)

    @property
    def photons(self) -> NDArray[np.float64] | None:
        """Photons of a pixel in the free beam, by view, (views,); None if no noise is stated.

        It is the number of equal photons that has the noise of many pixels together.
        """
        photons = self.provenance.free_photons
        return None if photons is None else photons.number * self._loads

    @property
    def _loads(self) -> NDArray[np.float64]:
        return np.ones(len(self)) if self.exposures_rel is None else self.exposures_rel

    def to_xarray(self, which: str | None = None) -> Any:
        """Return a labelled view of the scan, an ``xarray.Dataset`` that shares the images' memory.

        Its variables are transmission (view, row, column), and of one geometry source, detector, u
        and v (view, axis); of a simulated scan also joints (view, joint), time and clearance
        (view). Columns and rows are in mm from the middle of the panel.

        Args:
            which: name of the geometry, see ``poses``.

        Raises:
            InputError: xarray is not installed, or there is no geometry of this name.
        """
        xarray = optional("xarray", "Scan.to_xarray")
        geometry, panel = self.geometry(which), self.settings.detector.panel
        rows, columns = (np.arange(n) - (n - 1) / 2 for n in panel.shape)
        mm = {"units": "mm"}
        vectors = {"source": mm, "detector": mm, "u": {}, "v": {}}
        return xarray.Dataset(
            {
                "transmission": (("view", "row", "column"), self.transmission),
                **self.provenance.labelled(),
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
                "joint": np.array(self.provenance.joint_names, dtype=np.str_),
            },
            attrs={"scenario": self.settings.name, "geometry": which or self.reported.name},
        )

    @kinds_checked
    def show(
        self, path: str | Path | io.BytesIO | None = None, views: Sequence[int] | None = None
    ) -> None:
        """Show projections as line integrals in one grey window, seen from the source.

        Args:
            path: file for the picture, such as ``scan.png``, or a buffer for PNG; None opens a
                window, or shows it in the notebook.
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
        panel = self.settings.detector.panel
        images = line_integrals(self.transmission[chosen])
        columns = min(4, len(chosen))
        rows = -(-len(chosen) // columns)
        width, height = panel.size_mm
        size = 10.4, rows * (2.4 * height / width + 0.4) + 0.3
        show(partial(_draw, chosen, images, (rows, columns), (width, height)), size, path)

    def _repr_png_(self) -> bytes:
        """Return a PNG image of four projections, for a notebook."""
        picture = io.BytesIO()
        self.show(picture)
        return picture.getvalue()


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


def bad_pixels_of(detector: Detector, seed: int) -> NDArray[np.bool_] | None:
    """Return a detector's map of bad pixels, (rows, columns); None if it has none.

    Raises:
        InputError: the file with the map is unusable.
    """
    if detector.bad_pixels is None:
        return None
    from twinct.xray.build import build_bad_pixels

    return build_bad_pixels(detector, seed)
