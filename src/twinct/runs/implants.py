"""Known implants of a scan: estimation of their poses, and removal from the line integrals."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.geometry import Pose, ScanGeometry
from twinct.rays import Body
from twinct.recon.known_components import (
    Beam,
    BelievedImplant,
    FittedImplant,
    outside,
    without_implants,
)
from twinct.recon.metal import without_metal
from twinct.recon.projector import Projector
from twinct.recon.sart import sart
from twinct.recon.steps import Callback
from twinct.recon.surroundings import without_surroundings
from twinct.recon.volume import Volume
from twinct.runs.integrals import (
    corrected_for,
    hardening_corrected,
    main_material,
    materials_of,
)
from twinct.scenario import KnownImplants, Part
from twinct.scenario.imported import ScanSettings, beam_of
from twinct.specimen.materials import material
from twinct.specimen.shapes import shape_surface
from twinct.specimen.voxels import volume_fractions
from twinct.xray.build import build_response, build_spectrum, effective_energy_kev
from twinct.xray.implants import Corrected, MetalModel

if TYPE_CHECKING:
    from twinct.specimen.materials import Material

log = logging.getLogger(__name__)

_KEY = "reconstruction.metal"


@dataclass(frozen=True, eq=False)
class ImplantModels:
    """An implant as the scenario describes it.

    Attributes:
        name: name in messages.
        material: its material.
        implant: its shape and believed pose.
    """

    name: str
    material: Material
    implant: BelievedImplant


@dataclass(frozen=True, eq=False)
class ScanWithoutImplants:
    """Line integrals without known implants, and the implants.

    Attributes:
        line_integrals: (views, rows, columns), surroundings of the grid included.
        known: the implants that the scenario describes.
        fitted: the estimate for each of them.
        world_from_specimen: believed pose of the specimen.
        energy_kev: energy at which the volume's attenuation is given.
    """

    line_integrals: NDArray[np.float32]
    known: Sequence[ImplantModels]
    fitted: Sequence[FittedImplant]
    world_from_specimen: Pose
    energy_kev: float

    def put_back(self, volume: Volume) -> Volume:
        """Return a volume with the implants inserted, each voxel in proportion to its share.

        The estimates of the implants are added to the extras, as ``implants``.
        """
        array = np.array(volume.array)
        for one, fitted in zip(self.known, self.fitted, strict=True):
            body, mu = one.implant.body, one.material.mu_per_mm(self.energy_kev)
            share = volume_fractions(
                body.vertices, body.faces, volume.grid, fitted.world_from_implant
            )
            inside = np.flatnonzero(share)
            array.flat[inside] += share.flat[inside] * (mu - array.flat[inside])
        extras = dict(volume.extras) | {"implants": self.results()}
        return Volume(array, volume.grid, extras)

    def results(self) -> list[dict[str, Any]]:
        """Return pose, displacement and uncertainty of each implant, in the specimen's frame.

        Standard deviations of positions are along the specimen's axes, standard deviations of
        rotations about the implant's own axes.
        """
        specimen_from_world = self.world_from_specimen.inverse()
        entries: list[dict[str, Any]] = []
        for one, fitted in zip(self.known, self.fitted, strict=True):
            pose, believed = fitted.world_from_implant, one.implant.world_from_implant
            of_specimen = specimen_from_world @ pose
            position, rotation = of_specimen.to_euler()
            turn = of_specimen.rotation  # the covariance is in the implant's axes
            along = np.diag(turn @ fitted.covariance[:3, :3] @ turn.T)
            about = np.diag(fitted.covariance)[3:]
            entries.append(
                {
                    "name": one.name,
                    "position_mm": position.tolist(),
                    "rotation_deg": rotation.tolist(),
                    "moved_mm": pose.distance_mm(believed),
                    "turned_deg": pose.angle_deg(believed),
                    "position_sigma_mm": np.sqrt(along).tolist(),
                    "rotation_sigma_deg": np.degrees(np.sqrt(about)).tolist(),
                    "density_rel": fitted.density,
                    "slack_mm": float(np.sqrt(np.square(fitted.slack).sum(axis=1).mean())),
                }
            )
        return entries


def without_implants_of(
    settings: ScanSettings,
    section: KnownImplants,
    measured: NDArray[np.float32],
    A: Projector,
    mask: NDArray[np.bool_] | None,
    callback: Callback,
) -> ScanWithoutImplants:
    """Correct line integrals as the scenario states, and remove its known implants.

    Args:
        settings: believed source, detector and specimen.
        section: its ``reconstruction.metal``.
        measured: -ln of the transmission, (views, rows, columns).
        A: the projector, with the believed geometry.
        mask: True where a pixel counts.
        callback: callback of each ``sart``, except in the correction of beam hardening.
    """
    known = known_implants(settings, section)
    energy = effective_energy_kev(beam_of(settings, _KEY), settings.detector)
    mus: dict[str, Any] = {name: m.mu_per_mm(energy) for name, m in _prior(section).items()}
    inner, surroundings = _parted(
        settings, hardening_corrected(settings, measured, A, mask), A, mask
    )
    iterations = section.first_iterations
    mus["metal"] = min(one.material.mu_per_mm(energy) for one in known)
    first = partial(without_metal, first_iterations=iterations, mask=mask, callback=callback)
    replaced = first(A, inner, fit=False, **mus).line_integrals
    del inner
    background = sart(
        A, replaced, iterations=iterations, relaxation=0.3, mask=mask, callback=callback
    ).array
    del replaced
    taken = without_implants(
        A,
        _beam(settings, known, measured, A, mask),
        [one.implant for one in known],
        background,
        surroundings=surroundings,
        position_sigma_mm=section.position_sigma_mm,
        rotation_sigma_deg=section.rotation_sigma_deg,
        slack_mm=section.slack_mm,
        rounds=section.rounds,
        iterations=iterations,
        mask=mask,
        callback=callback,
    )
    stands = _place(settings)
    result = ScanWithoutImplants(taken.line_integrals, known, taken.fitted, stands, energy)
    for one in result.results():
        log.info(
            "implant %s: moved by %.3f mm and %.3f deg from where it was believed, density %.3f",
            *(one[key] for key in ("name", "moved_mm", "turned_deg", "density_rel")),
        )
    return result


def _parted(
    settings: ScanSettings,
    integrals: NDArray[np.float32],
    A: Projector,
    mask: NDArray[np.bool_] | None,
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Return the parts of line integrals inside the grid, and around it if the scenario says so."""
    around = settings.reconstruction.around
    if around is None:
        return integrals, None
    inner = without_surroundings(A, integrals, **around._asdict(), mask=mask)
    surroundings = integrals - inner
    if mask is not None:
        surroundings *= mask
    return inner, surroundings


def volumes_of(section: KnownImplants) -> int:
    """Return the number of SART iterations that ``without_implants_of`` reports."""
    return section.first_iterations * (2 + section.rounds)


def known_implants(settings: ScanSettings, section: KnownImplants) -> list[ImplantModels]:
    """Return the implants of a scenario at their believed poses.

    Raises:
        InputError: unknown names of parts; shapes or materials that cannot be built.
    """
    parts = {part.label: part for part in settings.specimen.parts} if settings.specimen else {}
    problems: list[str] = []
    known: list[ImplantModels] = []
    for i, implant in enumerate(section.implants):
        key = f"{_KEY}.implants.{i}"
        if (
            implant.part
            and implant.part not in parts
            and None in (implant.shape, implant.position_mm)
        ):
            problems.append(
                f"{key}.part: no part is called {quoted(implant.part)}; choose from {[*parts]}"
            )
            continue
        part: Part = implant.described_by(parts.get(implant.part))
        name = part.name or f"implant {i}"
        try:
            substance = material(part.material, f"{key}.material")
            mesh = shape_surface(part.shape, name)
            body = Body(mesh.vertices, mesh.faces)
        except InputError as error:
            problems += error.problems
            continue
        place = _place(settings) @ part.specimen_from_part
        known.append(ImplantModels(name, substance, BelievedImplant(body, place)))
    if problems:
        raise InputError(problems)
    return known


def _place(settings: ScanSettings) -> Pose:
    """Return ``world_from_specimen``; poses of implants in an unknown object are in the world."""
    return settings.specimen.world_from_specimen if settings.specimen else Pose.identity()


def check_implants(settings: ScanSettings, section: KnownImplants, views: ScanGeometry) -> None:
    """Check the known implants before any work.

    Raises:
        InputError: see ``known_implants``; attenuations that do not rise from tissue to bone to
            implant; implants outside the grid; views whose rays all pass through implants.
    """
    energy = effective_energy_kev(beam_of(settings, _KEY), settings.detector)
    known = known_implants(settings, section)
    tissue, bone = (one.mu_per_mm(energy) for one in _prior(section).values())
    problems: list[str] = []
    if tissue >= bone:
        problems.append(
            f"{_KEY}: bone attenuates by {bone:.3g}, tissue by {tissue:.3g} per mm: bone must "
            "exceed tissue"
        )
    for one in known:
        if (mu := one.material.mu_per_mm(energy)) <= bone:
            problems.append(
                f"{_KEY}: {one.name} of {one.material.name} attenuates by {mu:.3g} per mm, bone by "
                f"{bone:.3g}: an implant must exceed bone"
            )
    A = Projector(views, settings.reconstruction.volume_grid)
    names = [one.name for one in known]
    too_far = outside(A, [one.implant for one in known], names)
    if problems := problems + [f"{_KEY}: {problem}" for problem in too_far]:
        raise InputError(problems)


def _prior(section: KnownImplants) -> dict[str, Material]:
    names = ("tissue", "bone")
    return {name: material(getattr(section, name), f"{_KEY}.{name}") for name in names}


def _beam(
    settings: ScanSettings,
    known: Sequence[ImplantModels],
    measured: NDArray[np.float32],
    A: Projector,
    mask: NDArray[np.bool_] | None,
) -> Beam:
    """Return the beam's attenuation model for a background together with the implants."""
    section = settings.reconstruction.beam_hardening
    energy: float | None = effective_energy_kev(beam_of(settings, _KEY), settings.detector)
    spectrum, response = build_spectrum(beam_of(settings, _KEY)), build_response(settings.detector)
    materials = [] if section is None else materials_of(section)
    if section is None:  # soft tissue, as the material around the implants is unknown
        materials = [material("soft_tissue")]
        energy = None
    elif not materials:
        materials = [main_material(settings)]
    metals = [one.material for one in known]
    model = MetalModel(spectrum, response, materials, metals, energy)
    if section is None or section.kind == "one_material":
        corrected = hardening_corrected(settings, measured, A, mask)
        same = Corrected(model, measured, corrected, None)

        def for_any(_: NDArray[np.float32]) -> Corrected:
            return same

        return for_any

    def for_background(background: NDArray[np.float32]) -> Corrected:
        integrals, paths = corrected_for(settings, measured, A, background, mask, keep=True)
        return Corrected(model, measured, integrals, paths)

    return for_background
