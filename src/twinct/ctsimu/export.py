"""``twinct ctsimu export``: a twinct scan as a CTSimU scenario and an OpenCT free trajectory.

CTSimU has a rotating stage. Ours stands still in the world, and source, detector and specimen move
by drifts: of their centres, and of three rotations about the world's axes through the centres. The
believed motion is known to the reconstruction; the difference to the executed motion is not.

The OpenCT file is the one that ``twinct.exchange`` writes: the believed geometry in the grid's
frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.images import write_tiff
from twinct.core.files.links import own_folder
from twinct.core.files.writing import storage_errors, write_json
from twinct.core.foreign_text import quoted
from twinct.ctsimu.describe import describe, refuse_unsaid, render_options
from twinct.ctsimu.writing import (
    Json,
    as_material,
    header,
    make_folder,
    placed,
    quantity,
    sample,
    write_mesh,
)
from twinct.exchange.openct import openct_json
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.scan import Scan
from twinct.specimen import BuiltSpecimen


@dataclass(frozen=True)
class Exported:
    """Exported files.

    ``options`` for ``twinct ctsimu render`` reproduce the scan's own images; empty for ideal ones.
    """

    scenario: Path
    trajectory: Path
    options: str


def export_scan(
    scan: Scan,
    specimen: BuiltSpecimen,
    folder: Path,
    *,
    ideal: bool = False,
    geometry: str = "believed",
) -> Exported:
    """Write scenario, trajectory, meshes and projections to a folder, which is created if missing.

    Source and detector are written as in the scan, or as ideal ones. The named geometry is the one
    known to the reconstruction.

    Raises:
        InputError: the scan has no geometry of this name.
        InputError: the specimen has grey voxels.
        InputError: source or detector have a feature without a CTSimU equivalent; names it.
        ScanExistsError: the folder already holds an export.
        StorageError: the folder cannot be written.
    """
    if specimen.mixtures:
        raise InputError(
            f"specimen: part {quoted(specimen.mixtures[0].name)} has grey voxels; CTSimU describes "
            "samples by meshes of one material each"
        )
    known = scan.poses(geometry)
    name = "".join(c if c.isalnum() or c in "-_" else "_" for c in scan.scenario.name)
    options = "" if ideal else render_options(scan.scenario.source, scan.scenario.detector)
    files = Exported(folder / f"{name}.json", folder / f"{name}_openCT.json", options)
    if files.scenario.exists():  # written last
        raise ScanExistsError(f"{folder} already holds {files.scenario.name}: choose another --out")
    if not ideal:
        refuse_unsaid(scan.scenario.source, scan.scenario.detector, uneven_mas=scan.mas is not None)
    make_folder(folder)
    with storage_errors(folder):
        scenario = _scenario(scan, known, specimen, folder, name, ideal)
        images = own_folder(folder / "projections")
        for view, image in enumerate(scan.transmission):
            write_tiff(images / f"{name}_{view:04d}.tif", np.ascontiguousarray(image[::-1]))
        write_json(files.trajectory, _trajectory(scan, known, name))
        write_json(files.scenario, scenario)
    return files


def _scenario(
    scan: Scan, known: PosePairs, specimen: BuiltSpecimen, folder: Path, name: str, ideal: bool
) -> Json:
    turned = Rotation.from_euler("x", 180, degrees=True)  # our w points to the source

    def away(poses: Sequence[Pose]) -> list[Pose]:
        return [Pose(p.position, (Rotation.from_quat(p.quat) * turned).as_quat()) for p in poses]

    detector = _moving(away(known.detector), away(scan.executed.detector))
    source = _moving(known.source, scan.executed.source)
    substances: list[Json] = []
    samples = []
    for index, part in enumerate(specimen.parts):
        file = folder / f"{name}_{index}_{part.name}.obj"
        middle = write_mesh(part.mesh, file)
        shift = Pose(middle, np.array([0.0, 0.0, 0.0, 1.0]))
        poses = [pose @ shift for pose in scan.simulated.executed_object]
        substance = _listed(as_material(part.material), substances)
        samples.append(sample(part.name, file, substance, _moving(poses, poses, "rt")))
    views = len(scan)
    description = describe(scan.scenario.source, scan.scenario.detector, folder, name, ideal)
    for substance in description.materials:  # the scintillator's, if any
        description.detector["scintillator"]["material_id"] = _listed(substance, substances)
    still = _moving([Pose.identity()], [Pose.identity()])
    return {
        "file": header(scan.scenario.name, "Scan of a twin robotic CT system, by twinct"),
        "environment": {"material_id": None},
        "geometry": {"detector": detector, "source": {"type": "cone"} | source, "stage": still},
        "detector": description.detector,
        "source": description.source,
        "samples": samples,
        "acquisition": {
            "start_angle": quantity(0.0, "deg"),
            "stop_angle": quantity(0.0, "deg"),
            "direction": "CCW",
            "scan_mode": "stop+go",
            "number_of_projections": views,
            "include_final_angle": True,
            "frame_average": 1,
            **description.acquisition,
            "scattering": False,
        },
        "materials": substances,
        "simulation": {"twinct": {"scenario": scan.scenario.resolved()}},
    }


def _listed(substance: Json, substances: list[Json]) -> str:
    """Add a material to the list unless it is there, and return its id."""
    wanted, number = substance["id"], 1
    while any(s["id"] == substance["id"] and s != substance for s in substances):
        # Two materials may share a name, such as one formula at two densities.
        number += 1
        substance = substance | {"id": f"{wanted} ({number})"}
    if substance not in substances:
        substances.append(substance)
    return substance["id"]


def _moving(believed: Sequence[Pose], executed: Sequence[Pose], keys: str = "uw") -> Json:
    """Return a part of the world that drifts from its believed pose in view 0."""
    first = believed[0]
    known = np.array([p.position - first.position for p in believed])
    pairs = list(zip(believed, executed, strict=True))
    unknown = np.array([e.position - b.position for b, e in pairs])
    part = placed(first.position, first.rotation[:, 0], first.rotation[:, 2], keys)
    for axis, letter in enumerate("xyz"):
        drifts = [_drift(known[:, axis], "mm", True), _drift(unknown[:, axis], "mm", False)]
        part["center"][letter]["drifts"] = [drift for drift in drifts if drift]
    start = Rotation.from_quat(first.quat)
    to_believed = [Rotation.from_quat(p.quat) * start.inv() for p in believed]
    to_executed = [Rotation.from_quat(e.quat) * Rotation.from_quat(b.quat).inv() for b, e in pairs]
    return part | {"deviations": [*_turns(to_believed, True), *_turns(to_executed, False)]}


def _turns(rotations: Sequence[Rotation], known: bool) -> list[Json]:
    """Return rotations about the world's x, then y, then z, through the part's centre."""
    angles = np.array([rotation.as_euler("xyz") for rotation in rotations])
    turns = []
    for axis, letter in enumerate("xyz"):
        drift = _drift(angles[:, axis], "rad", known)
        if drift:
            amount = quantity(0.0, "rad") | {"drifts": [drift | {"known_to_reconstruction": True}]}
            turn = {"type": "rotation", "axis": letter, "amount": amount}
            turns.append(turn | {"known_to_reconstruction": known})
    return turns


def _drift(values: Floats, unit: str, known: bool) -> Json | None:
    if not values.any():
        return None
    return {"value": values.tolist(), "unit": unit, "known_to_reconstruction": known}


def _trajectory(scan: Scan, known: PosePairs, name: str) -> Json:
    grid = scan.scenario.reconstruction.volume_grid
    geometry = known.geometry(scan.scenario.detector.panel)
    local = grid.world_from_grid.inverse() @ geometry
    files = [f"{name}_{view:04d}.tif" for view in range(len(scan))]
    return openct_json(local, grid, f"{name}.img", files=files, file_type="TIFF", transmission=True)
