"""Import of a measured scan: its store, what is known beside it, and a picture of what was read."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.lock import sole_owner
from twinct.core.files.pictures import show
from twinct.core.files.writing import complete, storage_errors
from twinct.core.foreign_text import counted
from twinct.evaluation import coarse, views_needed
from twinct.geometry import ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.measured.beam import FreeBeam
from twinct.measured.corrections import Corrections, corrections
from twinct.measured.description import Measured, read_description
from twinct.measured.doubts import Doubts
from twinct.measured.imported_picture import SIZE_IN, draw_imported
from twinct.measured.looks import Looks
from twinct.measured.noise import FlatNoise, noise_of_flats
from twinct.measured.orientation import PanelPlacement, placed
from twinct.measured.sources import description_of, is_measured
from twinct.measured.stack import open_stack
from twinct.observers import Audience, Observers, audience_of
from twinct.recon.field_of_view import grid_of
from twinct.runs import Folder
from twinct.scan import Imported, ScanStore, check_space
from twinct.scenario.imported import ImportedSettings, load_imported
from twinct.xray.photons import FreePhotons
from twinct.xray.sections.detector import SnrNoise

NO_TRUTH = "A measured scan: there is no truth."

ONE_WAY = 0.4
"""Largest length of the mean direction of views that cover a turn; 240 degrees of it have 0.41."""

WIDEST = 10.0
"""Largest width of a panel in SDD: a fan of 157 degrees."""

_KNOWN = ("seed", "source", "detector", "xray", "reconstruction", "evaluation")
"""Sections that a description may add."""


@dataclass(frozen=True)
class ImportedScan:
    """Result of an import.

    Attributes:
        folder: the folder with ``scan.zarr`` and ``scenario.yaml``.
        settings: what is known of the scan, as it was written.
        notes: sentences on what was read, with units.
        doubts: sentences on statements that can be right, but seldom are.
    """

    folder: Path
    settings: ImportedSettings
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def import_measured(
    source: str | Path | Mapping[str, Any] | Measured,
    out: str | Path,
    observers: Observers = (),
) -> ImportedScan:
    """Create a run's folder from a measured scan.

    Args:
        source: description of the scan: a file or folder of ``description_of``, plain data, or
            its model.
        out: the folder, without a run in it.
        observers: notified of the views.

    Raises:
        InputError: images or geometry are missing, unreadable, or do not fit each other; nothing
            is written.
        ScanExistsError: the folder holds a scan.
        StorageError: the folder cannot be written.
    """
    description = source if isinstance(source, Measured) else _described(source)
    folder = Folder(Path(out))
    folder.refuse_others()
    folder.refuse_if_taken(resumes=False)
    stack = open_stack(description.images, "images")
    placement = placed(description, stack)
    images = corrections(description.images, stack, FreeBeam(placement))
    geometry = placement.geometry[:: description.images.every]
    _check_views(description, placement.geometry, geometry)
    noise = noise_of_flats(description.images, images.dark_of, placement.image)
    noise = noise and noise.at(images.brightness)
    settings = _settings(description, geometry, noise)
    if not views_needed(geometry, coarse(settings.reconstruction.volume_grid)):
        raise InputError(
            "grid: no view sees its voxels; without grid, the volume holds all that the views see"
        )
    check_space(folder.path, settings, len(geometry))
    files = (Path(description.images.path).name,)
    taken = Imported(settings, PosePairs.from_geometry(geometry), files)
    bad = placement.mask(images.bad) if images.bad.any() else None
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        stack.enter_context(storage_errors(folder.path))
        if not folder.path.exists():
            stack.callback(_remove_empty, folder.path)
        folder.path.mkdir(parents=True, exist_ok=True)
        stack.enter_context(sole_owner(folder.lock))
        stack.callback(_remove_unfinished, folder)
        # The scan comes last: without it, an import that was cut short can be repeated.
        draft = stack.enter_context(complete(folder.scan))
        looks = Looks(images)
        doubts = Doubts(description, images, geometry, looks)
        store = ScanStore.create_imported(draft, taken, bad)
        _write_views(store, placement, doubts, audience)
        folder.write_scenario(settings)
        show(partial(draw_imported, store.read(), placement, looks), SIZE_IN, folder.imported)
    views = placement.views
    notes = [
        *_notes_of_images(images, geometry, looks),
        *_notes_of_noise(settings, noise),
        *views.notes,
    ]
    sentences = *notes, *_notes_of_grid(settings), *looks.table
    return ImportedScan(folder.path, settings, sentences, (*views.doubts, *doubts.sentences))


def _described(source: str | Path | Mapping[str, Any]) -> Measured:
    if isinstance(source, Mapping):
        return read_description(source)
    path = Path(source).expanduser()
    return description_of(path) if is_measured(path) else read_description(path)


def _remove_unfinished(folder: Folder) -> None:
    """Remove the files of an import that was cut short: without its scan nothing needs them."""
    if not folder.scan.exists():
        folder.scenario.unlink(missing_ok=True)
        folder.imported.unlink(missing_ok=True)


def _remove_empty(path: Path) -> None:
    with suppress(OSError):  # it has files
        path.rmdir()


def _check_views(description: Measured, stored: ScanGeometry, used: ScanGeometry) -> None:
    """Raise if there is nothing to reconstruct from, or a correction needs other views."""
    if len(used) == 1 < len(stored):
        raise InputError(
            f"images.every: {description.images.every} leaves one of {len(stored)} views"
        )
    poses = np.concatenate([used.source, used.detector, used.u, used.v], axis=1)
    if len(used) > 1 and (poses == poses[0]).all():
        raise InputError(f"geometry: all {len(used)} views have the same pose")
    (width, height), near = used.panel.size_mm, used.sdd.min()
    if max(width, height) > WIDEST * near:
        raise InputError(
            f"geometry: the panel measures {width:.4g} x {height:.4g} mm at {near:.4g} mm from the "
            "source: are pitch and distances in mm?"
        )
    beams = used.detector - used.source
    one_way = np.linalg.norm((beams / np.linalg.norm(beams, axis=1, keepdims=True)).mean(axis=0))
    if description.images.rings is not None and one_way > ONE_WAY:
        raise InputError(
            "images.rings: the views must cover a turn, but they look one way: the mean of their "
            f"directions is {one_way:.2f} long; 0 is a turn, at most {ONE_WAY:g} is allowed"
        )


def _settings(
    description: Measured, geometry: ScanGeometry, noise: FlatNoise | None
) -> ImportedSettings:
    """Return what description and flats say of the scan besides images and geometry."""
    if others := [key for key in description.scenario if key not in _KNOWN]:
        raise InputError(
            f"scenario.{others[0]}: an imported scan has no such section: remove it; choose from "
            f"{', '.join(_KNOWN)}"
        )
    panel, further = geometry.panel, dict(description.scenario)
    detector = {
        **dict(further.pop("detector", {})),
        "columns": panel.columns,
        "rows": panel.rows,
        "pixel_pitch_mm": [panel.pitch_u, panel.pitch_v],
    }
    stated = detector.setdefault("noise", noise and noise.section)
    if isinstance(stated, dict) and stated.get("kind") == "quantum":
        raise InputError(
            "scenario.detector.noise.kind: quantum noise is simulated; a measured scan has kind: "
            "snr, with the signal-to-noise ratio of a pixel in the free beam"
        )
    reconstruction = {"algorithm": "fast", **dict(further.pop("reconstruction", {}))}
    if description.grid is not None:
        reconstruction["grid"] = description.grid.model_dump(mode="json")
    reconstruction.setdefault("grid", grid_of(geometry))
    return load_imported(
        {
            "name": description.name,
            "description": f"{description.description} {NO_TRUTH}".strip(),
            "detector": detector,
            "reconstruction": reconstruction,
            **further,
        }
    )


def _write_views(
    store: ScanStore, placement: PanelPlacement, doubts: Doubts, audience: Audience
) -> None:
    """Write all views, and count what they hold."""
    images = doubts.images
    every = images.section.every
    with audience.stage("import", store.views) as step:
        for view in range(store.views):
            corrected = images.transmission(view * every)
            doubts.looks.add(view * every, corrected)
            doubts.add(view * every, corrected)
            store.write(view, placement.image(corrected.image).astype(np.float32))
            step()


def _notes_of_images(images: Corrections, geometry: ScanGeometry, looks: Looks) -> list[str]:
    section, stack, panel = images.section, images.stack, geometry.panel
    notes = [
        f"{stack.where}: {stack.count} images of {stack.shape[0]} x {stack.shape[1]} pixels (rows "
        f"x columns), {stack.dtype}, as {section.values.replace('_', ' ')}",
        *stack.notes,
    ]
    changes = [
        *(["transposed"] if section.transpose else []),
        *([f"turned by {section.turn_deg} deg"] if section.turn_deg else []),
        *(["rows reversed"] if section.flip_rows else []),
        *(["columns reversed"] if section.flip_columns else []),
        *(["cut"] if any(section.crop.model_dump().values()) else []),
        *([f"{section.bin} x {section.bin} pixels averaged"] if section.bin > 1 else []),
        *([f"every {section.every}th view"] if section.every > 1 else []),
    ]
    if changes:
        notes.append(
            f"images {', '.join(changes)}: {len(geometry)} views of {panel.rows} x {panel.columns}"
        )
    if images.bad.any():
        notes.append(f"bad pixels: {int(images.bad.sum())} of {images.bad.size}, filled")
    if images.gains is not None and section.rings is not None:
        off = images.gains - 1
        notes.append(
            f"rings: gains of pixels corrected by {100 * np.sqrt(np.mean(off**2)):.2g} % (RMS), at "
            f"most {100 * np.abs(off).max():.2g} %, from the mean of {len(geometry)} views and a "
            f"median of {section.rings.width} pixels along the rows (Boin and Haibel 2006)"
        )
    if images.scaled:
        low, high = min(looks.scales), max(looks.scales)
        notes.append(f"air: {low:.4g} to {high:.4g}, scaled to 1 in each view")
    if images.falls:
        notes.append(
            f"air: divided by the beam's fall-off, from 1 to {images.least_beam:.4g}, as the "
            "geometry states it"
        )
    return notes


def _notes_of_noise(settings: ImportedSettings, measured: FlatNoise | None) -> list[str]:
    noise = settings.detector.noise
    if not isinstance(noise, SnrNoise):
        return []
    source = "as stated"
    if measured is not None and noise.snr == measured.section["snr"]:
        source = f"from {counted(measured.pairs, 'pair')} of flats"
    photons = FreePhotons.of_snr(noise).number
    return [
        f"noise: a pixel in air has a signal-to-noise ratio of {noise.snr:.4g}, {source}; means of "
        f"many pixels have the noise of {photons:.4g} photons a pixel"
    ]


def _notes_of_grid(settings: ImportedSettings) -> list[str]:
    grid = settings.reconstruction.volume_grid
    voxels, edges = grid.shape_xyz, grid.voxel.tolist()
    return [
        f"grid: {' x '.join(map(str, voxels))} voxels (x, y, z) of "
        f"{' x '.join(f'{edge:.4g}' for edge in edges)} mm"
    ]
