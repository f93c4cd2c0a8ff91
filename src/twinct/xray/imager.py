"""The imager: transmission images of a specimen from executed views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError, TwinctError
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.specimen import BuiltSpecimen, Part
from twinct.specimen.part import rendered
from twinct.specimen.signals import Inserts
from twinct.xray._owner import SceneOwner
from twinct.xray._placement import SpecimenObstacle, longest_edge, mesh_fault, split
from twinct.xray.build import build_panel_response, effective_energy_kev, physical_panel
from twinct.xray.chain import ImagingChain, ViewImages
from twinct.xray.engine import SceneBody
from twinct.xray.engines import DEFAULT_ENGINE, engine_named
from twinct.xray.inserts import Insertion
from twinct.xray.own_rays import OwnRays, room_rays
from twinct.xray.paths import LARGEST_TILE, PathRenderer, materials_of
from twinct.xray.sections import Detector, Source

if TYPE_CHECKING:
    from twinct.specimen.moving_voxels import MovingVoxels
    from twinct.xray.monte_carlo_scatter import ScatterNodes

_NEAREST_MM = 150.0
"""Distance from source to specimen if there are no commanded views."""


class Imager(SceneOwner):
    """Renderer for views of one specimen with one source and one panel.

    The meshes are uploaded once, in the specimen's frame; each view is expressed in that frame.
    Only one imager of meshes can be open in a process. It may be used from any thread, by one
    thread at a time. Parts that engines do not render are cast by rays of their own; if all are, no
    engine is loaded.

    A monochromatic point source and an ideal detector give the engine's own image of the meshes,
    each pixel sampled at its centre. All other cases use path lengths (``PathRenderer``) and a
    ``ImagingChain``; an image then costs one render per point of the focal spot and instant of the
    exposure.
    """

    def __init__(
        self,
        source: Source,
        detector: Detector,
        specimen: BuiltSpecimen,
        *,
        commanded: ScanGeometry | None = None,
        seed: int = 0,
        mas: Floats | None = None,
        engine: str = DEFAULT_ENGINE,
        objects: Sequence[Part] = (),
    ) -> None:
        """Upload the specimen.

        Args:
            source: source section of the scenario.
            detector: detector section, with the panel of every view and the response to photons.
            specimen: disjoint parts, in the specimen's frame, mm.
            commanded: views of the scan; by default the first rendered view. The first sets the
                detector's gain and is the view of the flat image, which is scaled for the others. A
                view beyond them counts as commanded in its executed geometry.
            seed: key of the noise, together with the index of the view.
            mas: tube load of each commanded view, (views,), mAs; ``source.mas`` by default.
            engine: name of the X-ray engine.
            objects: objects of the room that the beam sees, closed meshes in the world, mm.

        Raises:
            SpecimenError: there is nothing to image, a mesh is open, or an attenuation is not
                finite or is negative.
            InputError: the engine, SpekPy or a system library is missing, or a file is unusable.
            TwinctError: another imager is open in this process, or the engine failed.
        """
        self.panel = detector.panel
        self._source, self._detector, self._seed = source, detector, seed
        self._commanded, self._mas = commanded, mas
        self._paths: PathRenderer | None = None
        self._exposure_s = source.exposure_ms / 1000
        self._chain: ImagingChain | None = None
        self._specimen = specimen
        self._scatter: ScatterNodes | None = None
        edge = longest_edge(_nearest_mm(specimen, commanded))
        if source.ideal and detector.ideal and max(self.panel.shape) <= LARGEST_TILE:
            self._open_ideal(specimen, edge, engine, objects)
        else:
            self._materials = materials_of(specimen.parts, objects)
            self._inserted = self._inserts_into(specimen)
            if commanded is not None:  # now, to report unusable files at once
                self._chain = self._new_chain(commanded)
            self._paths = PathRenderer(
                specimen.parts,
                physical_panel(detector),
                detector.pixel_samples,
                edge,
                engine,
                objects,
            )
            self._open = True
        self._moving = self._moving_of(specimen)

    def _moving_of(self, specimen: BuiltSpecimen) -> MovingVoxels | None:
        if specimen.motion is None:
            return None
        from twinct.specimen.moving_voxels import moving_voxels

        own = self._own if self._paths is None else self._paths.own
        return moving_voxels(specimen.motion, own.parts, own.casters, self._exposure_s)

    def _inserts_into(self, specimen: BuiltSpecimen) -> tuple[int, float]:
        """Return the material that stands for inserted signals, and its attenuation, 1/mm."""
        energy = effective_energy_kev(self._source, self._detector)
        own = specimen.reference_part.material
        index = self._materials.index(own) if own in self._materials else 0
        return index, float(self._materials[index].mu_per_mm(energy))

    def _open_ideal(
        self, specimen: BuiltSpecimen, edge_mm: float, engine: str, objects: Sequence[Part]
    ) -> None:
        """Upload all that is imaged by one frame of the engine, and prepare all other rays."""
        energy_kev = self._source.energy_kev
        bodies = _bodies(specimen, energy_kev, edge_mm)
        self._placement = SpecimenObstacle([(part.name, part.mesh) for part in specimen.parts])
        self._own = OwnRays([part for part in specimen.parts if part.own_rays], self.panel)
        self._room = room_rays(objects, self.panel)
        if bodies:
            self._acquire(engine_named(engine).engine, bodies, self.panel)
        self._open = True

    def render(
        self, geometry: ScanGeometry, world_from_object: Pose, view: int = 0
    ) -> NDArray[np.float32]:
        """Take one view at one instant.

        Args:
            geometry: exactly one view, in the world, with the panel of this imager.
            world_from_object: pose of the specimen's frame at exposure.
            view: index of the view, which keys its noise.

        Returns:
            Transmission I/I0, corrected by the flat and dark images, (rows, columns). It is 1 in
            the free beam, except for noise and for the pose difference between the view and its
            flat image.

        Raises:
            ValueError: ``geometry`` is not one view, or has another panel.
            TwinctError: the imager is closed, the specimen reaches through the panel, the source is
                inside the specimen, or the engine failed.
        """
        if len(geometry) != 1:
            raise ValueError(f"render takes one view at a time, not {len(geometry)}")
        if geometry.panel != self.panel:
            raise ValueError(f"the view has {geometry.panel}; the imager was made for {self.panel}")
        return self._image(geometry, (world_from_object,), view, None, 0.0)

    def expose(
        self,
        path: PosePairs,
        view: int = 0,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
    ) -> NDArray[np.float32]:
        """Take one view during motion: the mean over the instants of the path.

        Args:
            path: executed poses of source, panel and specimen at instants of equal duration, at
                least one; the middle one is the view's geometry.
            view: index of the view, which keys its noise.
            before: poses of the previous view, whose signal lags; None for the first view.
            time_s: time of the scan at the middle of the exposure, for a patient who breathes.

        Returns:
            Transmission, (rows, columns). See ``render``, also for the exceptions.
        """
        return self._image(path.geometry(self.panel), path.object, view, before, time_s)

    def frame(
        self,
        path: PosePairs,
        view: int = 0,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
    ) -> ViewImages:
        """Take one view with raw, flat and dark images, which an ideal detector does not have."""
        if self._paths is None:
            raise ValueError("an ideal source and detector give only a transmission")
        return self._frame(path.geometry(self.panel), path.object, view, before, time_s)

    def repeated(
        self,
        path: PosePairs,
        view: int,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
        repetitions: Sequence[int] = (),
    ) -> list[NDArray[np.float32]]:
        """Take one view again, each time with noise of its own.

        Args:
            path: see ``expose``, also for the following ones.
            view: index of the view.
            before: poses of the previous view.
            time_s: time of the scan.
            repetitions: numbers of the scans; 0 gives the image of ``expose``.

        Returns:
            Transmission of each, (rows, columns).
        """
        if self._paths is None:
            return [self.expose(path, view, before, time_s=time_s)] * len(repetitions)
        seen = path.geometry(self.panel)
        chain, expected, last = self._exposure(seen, path.object, view, before, time_s, None)
        middle = chain.physical(seen[len(seen) // 2])
        return [
            chain.frame(expected, middle, view, last, number).transmission for number in repetitions
        ]

    def inserted(
        self,
        path: PosePairs,
        view: int,
        inserts: Inserts,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
    ) -> NDArray[np.float32]:
        """Return the share of the light of a view that inserted signals let pass.

        The images have all physics of the view except noise. A signal counts as more or less of the
        reference's material, or of the specimen's first material if that one is grey.

        Args:
            path: see ``expose``, also for the others.
            view: index of the view.
            inserts: signals, which move with the specimen.
            before: poses of the previous view.
            time_s: time of the scan.

        Returns:
            Light with the signals over light without them, (rows, columns).
        """
        seen, insertion = path.geometry(self.panel), Insertion(inserts)
        if self._paths is None:
            means = [
                np.mean([self._ideal(seen[k], path.object[k], one) for k in range(len(seen))], 0)
                for one in (insertion, None)
            ]
        else:
            means = []
            for one in (insertion, None):
                chain, light, last = self._exposure(seen, path.object, view, before, time_s, one)
                means.append(chain.mean(light, last))
        share = np.ones(self.panel.shape)
        np.divide(means[0], means[1], out=share, where=np.asarray(means[1]) > 0)
        return share.astype(np.float32)

    def _image(
        self,
        path: ScanGeometry,
        objects: Sequence[Pose],
        view: int,
        before: PosePairs | None,
        time_s: float,
    ) -> NDArray[np.float32]:
        if not self._open:
            raise TwinctError("the X-ray imager was closed")
        if self._paths is not None:
            return self._frame(path, objects, view, before, time_s).transmission
        images = [self._ideal(path[k], objects[k]) for k in self._instants(len(path), time_s)]
        if len(images) == 1:
            return images[0]
        return np.asarray(np.mean(images, axis=0, dtype=np.float64), dtype=np.float32)

    def _instants(self, count: int, time_s: float) -> Iterator[int]:
        """Yield the numbers of the instants of an exposure, each with the patient in its state."""
        for number in range(count):
            if self._moving is not None:
                self._moving.show(time_s, number, count)
            yield number

    def _frame(
        self,
        path: ScanGeometry,
        objects: Sequence[Pose],
        view: int,
        before: PosePairs | None,
        time_s: float,
    ) -> ViewImages:
        middle = path[len(path) // 2]
        chain, expected, last = self._exposure(path, objects, view, before, time_s, None)
        return chain.frame(expected, chain.physical(middle), view, last)

    def _exposure(
        self,
        path: ScanGeometry,
        objects: Sequence[Pose],
        view: int,
        before: PosePairs | None,
        time_s: float,
        insertion: Insertion | None,
    ) -> tuple[ImagingChain, NDArray[np.float32], NDArray[np.float32] | None]:
        """Return the chain, the expected signal of a view, and that of the view before, if it lags.

        See ``ImagingChain.frame``.
        """
        chain = self._chain = self._chain or self._new_chain(
            self._commanded or path[len(path) // 2]
        )
        last = None
        if self._detector.lag and before is not None:
            seen = before.geometry(self.panel)
            last = self._expected(chain, seen, before.object, view - 1, time_s, insertion)
        return chain, self._expected(chain, path, objects, view, time_s, insertion), last

    def _expected(
        self,
        chain: ImagingChain,
        path: ScanGeometry,
        objects: Sequence[Pose],
        index: int,
        time_s: float,
        insertion: Insertion | None,
    ) -> NDArray[np.float32]:
        assert self._paths is not None
        expected = chain.blank()
        share = chain.load(index) / (len(path) * len(chain.spot))
        for k in self._instants(len(path), time_s):
            for seen in chain.from_spot(chain.physical(path[k])):
                paths = self._paths.render(seen, objects[k])
                if insertion is not None:
                    material, per_mm = self._inserted
                    lengths = insertion.attenuation(objects[k].inverse() @ seen, chain.samples)
                    paths[material] += lengths / per_mm
                chain.add(paths, seen, expected, share)
        if self._scatter is not None:
            middle = len(path) // 2
            scatter = self._scatter.image(objects[middle].inverse() @ path[middle])
            chain.add_scatter(scatter, expected, chain.load(index))
        return expected

    def _new_chain(self, commanded: ScanGeometry) -> ImagingChain:
        sections = self._source, self._detector
        chain = ImagingChain(*sections, self._materials, commanded, self._seed, self._mas)
        if (settings := self._detector.scatter) is not None:
            from twinct.xray.monte_carlo_scatter import scatter_of

            panel = build_panel_response(self._detector), chain.grid, chain.panel
            self._scatter = scatter_of(settings, self._specimen, chain.beam, *panel, commanded)
        return chain

    def _ideal(
        self,
        geometry: ScanGeometry,
        world_from_object: Pose,
        insertion: Insertion | None = None,
    ) -> NDArray[np.float32]:
        view = world_from_object.inverse() @ geometry
        self._placement.check(view)
        image = np.ones(self.panel.shape, dtype=np.float32)
        if self._engine is not None:
            self._engine.render(view, image)
        for rays, seen in ((self._own, view), (self._room, geometry)):
            for depth in rays.depths(seen, self._source.energy_kev):
                image *= np.exp(-depth)
        if insertion is not None:
            image *= np.exp(-insertion.attenuation(view))
        return image

    def _release(self) -> None:
        if self._paths is not None:
            self._paths.close()
        else:
            super()._release()


def _nearest_mm(specimen: BuiltSpecimen, commanded: ScanGeometry | None) -> float:
    """Return the approximate distance from the source to the specimen's nearest point; never 0."""
    if commanded is None or not specimen.parts:
        return _NEAREST_MM
    low, high = specimen.bounds
    centre = specimen.world_from_specimen.apply((low + high) / 2)
    distance = float(np.linalg.norm(commanded.source[0] - centre))
    return max(distance - float(np.linalg.norm(high - low)) / 2, distance / 10)


def _bodies(specimen: BuiltSpecimen, energy_kev: float, longest_edge_mm: float) -> list[SceneBody]:
    if not specimen.parts:
        raise SpecimenError("the specimen has no parts: there is nothing to image")
    problems: list[str] = []
    bodies: list[SceneBody] = []
    for part in specimen.parts:
        if part.own_rays and (fault := mesh_fault(part.mesh)):
            problems.append(f"part '{part.name}' {fault}")
    for part in rendered(specimen.parts):
        mu_per_mm = float(part.material.mu_per_mm(energy_kev))
        fault = mesh_fault(part.mesh)
        if fault is None and not (np.isfinite(mu_per_mm) and mu_per_mm >= 0):
            fault = f"has an attenuation of {mu_per_mm:g}/mm; it must be finite and not negative"
        if fault:
            problems.append(f"part '{part.name}' {fault}")
        else:
            mesh = split(part.mesh, longest_edge_mm)
            bodies.append(SceneBody(np.asarray(mesh.vertices), np.asarray(mesh.faces), mu_per_mm))
    if problems:
        raise SpecimenError(problems)
    return bodies
