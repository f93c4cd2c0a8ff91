"""A scan rendered again: what calibration, spectrum and scatter leave of the measured images.

The object is the scan's own volume, reconstructed from the even views as a grey volume, which
predicts the odd views; or the meshes of a specimen, which predict all views. Both go through the
scenario's X-ray simulation, without noise, at the poses of a geometry.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.files.boundary import no_file
from twinct.core.files.lock import sole_owner
from twinct.core.files.writing import (
    complete,
    remove_folder,
    storage_errors,
    write_json,
    write_text,
)
from twinct.core.foreign_text import counted
from twinct.core.interruption import keeping
from twinct.geometry import Pose, ScanGeometry
from twinct.measured.predicted_mesh import check_seen
from twinct.measured.prediction_picture import show_prediction
from twinct.observers import Audience, Observers, audience_of
from twinct.recon import Projector
from twinct.recon.residuals import CAUSES, Residuals, residuals_of
from twinct.report import plain
from twinct.runs import Folder, load_scan, reconstruct
from twinct.runs.log import logged_to
from twinct.runs.reconstruction_folder import free_name, stored_reconstructions
from twinct.runs.reporting import write_volumes
from twinct.scan import Scan
from twinct.scenario import Source, Specimen
from twinct.scenario.imported import ScanSettings
from twinct.specimen import BuiltSpecimen, build_specimen
from twinct.specimen.size import specimen_size

log = logging.getLogger(__name__)

FORMAT = "twinct prediction 1"
OWN_VOLUME = "volume"
CHECKPOINTS = ".checkpoints"
"""Folder of an unfinished reconstruction below ``predictions``; those of a run are beside it."""

SECTIONS = "source", "detector", "specimen", "reconstruction", "xray"
"""Sections of the scenario whose keys a prediction may change."""

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted views beside the measured ones.

    Attributes:
        name: name of its folder, below ``predictions``.
        in_words: object, geometry and beam in one line.
        geometry: name of the geometry.
        residuals: figures of the views.
        path: its folder, with ``prediction.json``, ``views.csv``, ``prediction.png`` and
            ``residuals.tif``.
    """

    name: str
    in_words: str
    geometry: str
    residuals: Residuals
    path: Path

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what is left."""
        total = self.residuals
        left = ", ".join(
            f"{100 * rest:.2f} % after {cause}"
            for cause, rest in zip(CAUSES, total.left_rel, strict=True)
        )
        shifts = np.abs([one.shift_px for one in total.views])
        across, down = np.median(shifts, axis=0)
        worst = sorted(total.views, key=lambda one: -one.rms_rel)[:3]
        return (
            self.in_words,
            f"{counted(len(total.views), 'view')} predicted: residual {100 * total.rms_rel:.2f} %, "
            f"of which may be explained: {left}",
            f"shadows are off by {across:.3f} px along columns and {down:.3f} px along rows "
            f"(medians, largest {shifts.max():.3f} px); worst views: "
            + ", ".join(f"{one.view} ({100 * one.rms_rel:.2f} %)" for one in worst),
        )


@kinds_checked
def predict(
    path: str | Path,
    overrides: Iterable[str] = (),
    *,
    geometry: str | None = None,
    mesh: str | Path | None = None,
    material: str | None = None,
    name: str | None = None,
    observers: Observers = (),
) -> Prediction:
    """Render a scan again and compare it with its images, view by view.

    Without a mesh, the even views are reconstructed and predict the odd ones. With a mesh, or keys
    of ``specimen.parts``, that object predicts all views.

    Args:
        path: folder of a run or of ``import_measured``.
        overrides: changes ``SECTION.KEY=VALUE`` to the ``SECTIONS`` of its scenario.
        geometry: geometry of all views; None: the scenario's first.
        mesh: mesh file in mm, in the world; ``specimen.position_mm`` moves it.
        material: material of the mesh, or of the voxels if there is a spectrum; water by default.
        name: name of the result, below ``predictions``; None: ``volume``, or the mesh's name.
        observers: notified of stages and iterations.

    Raises:
        InputError: no scan, an unknown geometry, a key of another section, a mesh or material that
            cannot be used, a mesh outside all views, or fewer than four views.
        ScanExistsError: the name is taken.
    """
    from twinct.specimen.materials import material as known_material

    folder = Folder(Path(path))
    if material is not None:
        known_material(material, "--material")
    scan = load_scan(folder.path)
    settings, body = _settings(folder, overrides, mesh, material)
    scan = scan.with_settings(settings)
    which = geometry or settings.reconstruction.geometries[0]
    scan.poses(which)
    if len(scan) < 4:
        raise InputError(
            f"{folder.path}: {counted(len(scan), 'view')}; a prediction needs at least 4"
        )
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        stack.enter_context(storage_errors(folder.path))
        stack.enter_context(sole_owner(folder.lock))
        base = OWN_VOLUME if body is None else Path(mesh).stem if mesh else "specimen"
        target = folder.predictions / free_name(name, base, folder.predictions, "prediction")
        stack.enter_context(logged_to(folder.log))
        checkpoints = folder.predictions / CHECKPOINTS
        stack.enter_context(keeping(lambda: _kept(checkpoints)))
        substance = material or "water"
        made = _predicted(scan, body, which, substance, checkpoints, target, audience)
        remove_folder(checkpoints)
        now = load_scan(folder.path)
        if now.settings.specimen is None and stored_reconstructions(folder.reconstructions):
            write_volumes(folder, now)
    return made


def _predicted(
    scan: Scan,
    body: Specimen | None,
    which: str,
    substance: str,
    checkpoints: Path,
    target: Path,
    audience: Audience,
) -> Prediction:
    """Make and write a prediction of a body, or of the scan's own volume if it is None."""
    settings, views, chosen = scan.settings, scan.geometry(which), np.arange(len(scan))
    if body is not None:
        specimen = build_specimen(body)
        check_seen(specimen, views)
        grid = settings.reconstruction.volume_grid
        size = specimen_size(body, specimen, views, grid)
        for warning in size.warnings:
            audience.say(warning, warning=True)
        words = f"meshes, as {', '.join(one.name for one in specimen.materials)}"
        counts = np.ones((len(scan), *views.panel.shape), bool)
    else:
        words, specimen, counts = _own_volume(scan, views, substance, checkpoints, audience)
        chosen = chosen[1::2]
    words = f"{words}; {which} geometry; {_beam_in_words(settings)}"
    log.info("prediction %s: %s", target.name, words)
    if scan.bad_pixels is not None:
        counts &= ~scan.bad_pixels
    measured = scan.line_integrals()[chosen]
    predicted = _rendered(settings, specimen, views[chosen], audience)
    with audience.stage("residuals", 1) as step:
        residuals = residuals_of(chosen, measured, predicted, counts)
        made = Prediction(target.name, words, which, residuals, target)
        _write(made, measured, predicted, views.panel.pitch_u)
        step()
    return made


def _settings(
    folder: Folder, overrides: Iterable[str], mesh: str | Path | None, material: str | None
) -> tuple[ScanSettings, Specimen | None]:
    """Return the scan's settings with the changes of a prediction, and the body, if it is known."""
    changes = tuple(overrides)
    for one in changes:
        if one.partition("=")[0].partition(".")[0] not in SECTIONS:
            known = ", ".join(SECTIONS)
            raise InputError(f"--set {one}: a prediction changes only keys of {known}")
    keys: dict[str, Any] = {"detector.noise": None, "detector.readout": None}
    keys |= {"detector.bad_pixels": None, "detector.lag": 0.0, "detector.keep": []}
    keys |= {"evaluation": None}
    if mesh is not None:
        if why := no_file(Path(mesh)):
            raise InputError(f"--mesh {mesh} {why}")
        shape = {"kind": "mesh", "path": str(Path(mesh).absolute())}
        parts = [{"name": Path(mesh).stem, "shape": shape, "material": material or "water"}]
        keys |= {"specimen.parts": parts, "specimen.reference": "", "specimen.motion": None}
        keys["reconstruction.motion"] = None
    settings = folder.settings_of_scan(changes, keys)
    stated = mesh is not None or any(one.startswith("specimen.parts") for one in changes)
    return settings, settings.specimen if stated else None


def _kept(checkpoints: Path) -> str:
    """Return what an interruption keeps; a folder without a checkpoint goes."""
    if checkpoints.is_dir() and any(checkpoints.glob("*.npz")):
        return "the same command goes on from the last checkpoint"
    remove_folder(checkpoints)
    with suppress(OSError):  # it has predictions
        checkpoints.parent.rmdir()
    return ""


def _own_volume(
    scan: Scan, views: ScanGeometry, substance: str, checkpoints: Path, audience: Audience
) -> tuple[str, BuiltSpecimen, NDArray[np.bool_]]:
    """Reconstruct the even views, corrected for a stated spectrum.

    Returns:
        The object in words, the grey volume, and the rays of the odd views that count.
    """
    from twinct.specimen.grey_object import grey_specimen
    from twinct.specimen.materials import material
    from twinct.xray.build import effective_energy_kev

    basis, source = material(substance, "--material"), _beam(scan.settings)
    energy = effective_energy_kev(source, scan.settings.detector)
    bent = source.spectrum is not None
    if bent and scan.settings.reconstruction.beam_hardening is None:
        key = "reconstruction.beam_hardening"
        hardens = {key: {"kind": "one_material", "material": substance}}
        scan = scan.with_settings(scan.settings.with_(hardens))
    even = scan.of_views(range(0, len(scan), 2))
    volume = reconstruct(even, geometry=views[::2], checkpoints=checkpoints, observers=audience)
    A = Projector(views[1::2], volume.grid)
    counts = A(np.ones(volume.shape, np.float32)) > 0
    words = f"{scan.settings.reconstruction.in_words} of the even views"
    specimen = grey_specimen(volume.array, volume.grid, basis, energy, OWN_VOLUME)
    return (f"{words}, as {substance}" if bent else words), specimen, counts


def _rendered(
    settings: ScanSettings, specimen: BuiltSpecimen, views: ScanGeometry, audience: Audience
) -> Singles:
    """Return the line integrals of rendered views, (views, rows, columns)."""
    from twinct.scan import line_integrals
    from twinct.xray import Imager

    images = np.empty((len(views), *views.panel.shape), np.float32)
    stands: Pose = specimen.world_from_specimen
    beam, engine = (_beam(settings), settings.detector), settings.xray.engine
    with (
        Imager(*beam, specimen, commanded=views, seed=settings.seed, engine=engine) as imager,
        audience.stage("predict", len(views)) as step,
    ):
        for view, image in enumerate(images):
            image[:] = imager.render(views[view], stands, view)
            step()
    return line_integrals(images)


def _beam(settings: ScanSettings) -> Source:
    """Return the stated beam; without one, a single energy, which the prediction names."""
    return Source() if settings.source is None else settings.source


def _beam_in_words(settings: ScanSettings) -> str:
    from twinct.xray.build import effective_energy_kev

    source, detector = _beam(settings), settings.detector
    energy = effective_energy_kev(source, detector)
    spectrum = (
        f"one energy of {energy:.4g} keV, as no spectrum is stated"
        if source.spectrum is None
        else f"{source.spectrum.kind} spectrum, {energy:.4g} keV effective"
    )
    return f"{spectrum}; scatter {'estimated' if detector.scatter else 'not modelled'}"


def _write(made: Prediction, measured: Singles, predicted: Singles, pitch: float) -> None:
    """Write the folder, which appears when it is complete."""
    from tifffile import imwrite

    residuals = made.residuals
    made.path.parent.mkdir(parents=True, exist_ok=True)
    with complete(made.path) as draft:
        draft.mkdir()
        data: dict[str, Any] = {
            "format": FORMAT,
            "name": made.name,
            "in_words": made.in_words,
            "geometry": made.geometry,
            "residual_rel": residuals.rms_rel,
            "left_rel": dict(zip(CAUSES, residuals.left_rel, strict=True)),
            "curve": residuals.curve.tolist(),
            "views": [asdict(one) for one in residuals.views],
        }
        write_json(draft / "prediction.json", plain(data))
        write_text(draft / "views.csv", _table(residuals))
        facts = {"unit": "mm", "values": "line integrals, measured minus predicted"}
        numbers = [one.view for one in residuals.views]
        imwrite(
            draft / "residuals.tif",
            measured - predicted,
            photometric="minisblack",
            resolution=(10 / pitch, 10 / pitch),
            resolutionunit="CENTIMETER",
            metadata={**facts, "views": numbers},
        )
        show_prediction(draft / "prediction.png", measured, predicted, residuals)


def _table(residuals: Residuals) -> str:
    head = "view,rms,rms_rel,mean,shift_column_px,shift_row_px," + ",".join(
        f"left_after_{cause}" for cause in CAUSES
    )
    rows = (
        [one.view, one.rms, one.rms_rel, one.mean, *one.shift_px, *one.left_rel]
        for one in residuals.views
    )
    return "\n".join([head, *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"
