"""Files of a scenario that is not run: a picture of the room, the specimen, a robot description."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.writing import (
    check_folder,
    check_picture,
    complete,
    storage_errors,
    write_text,
)
from twinct.recon.volume import Volume
from twinct.robots.cell import check_drawing, check_picture_size
from twinct.runs.remedies import draw_anyway
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, as_scenario
from twinct.specimen import BuiltSpecimen
from twinct.specimen.preview import preview_specimen
from twinct.xray.build import effective_energy_kev


@kinds_checked
def draw_view(
    scenario: Scenario | str | Path,
    out: str | Path,
    *,
    view: int | None = None,
    width: int = 1600,
    height: int = 1000,
) -> list[str]:
    """Draw the operating room at one view, even if it is infeasible, and return its problems.

    Collisions are red, a source or panel out of reach is a ghost at its target, and its arm is in
    the nearest configuration.

    Args:
        scenario: the scenario, or its file.
        out: PNG file to write.
        view: view at which source and panel are drawn; None: the middle one.
        width: width of the picture in pixels.
        height: height of the picture in pixels.

    Raises:
        InputError: there is no such view, or the size is out of range.
        MissingExtraError: the extra ``robots`` is not installed.
        DrawingError: pictures cannot be drawn here.
        StorageError: the file cannot be written.
    """
    scenario, out = as_scenario(scenario), Path(out)
    check_picture(out)
    check_picture_size(width, height)
    require("robots")
    check_drawing()
    builder = SimulationBuilder(scenario)
    views = len(builder.requested)  # commanded views need a plan, which may not exist
    view = views // 2 if view is None else view
    if not 0 <= view < views:
        raise InputError(f"--view {view}: the scenario has views 0 to {views - 1}")
    with storage_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        return draw_anyway(builder, out, view, width, height)


@kinds_checked
def write_specimen(scenario: Scenario | str | Path, out: str | Path) -> tuple[BuiltSpecimen, float]:
    """Build the specimen only, and write a mesh for each part, the voxel truth and a picture.

    Args:
        scenario: the scenario, or its file.
        out: folder for PART.stl, truth.nii and specimen.png.

    Returns:
        the specimen, and the energy of the truth's attenuation, keV.

    Raises:
        SpecimenError: the specimen cannot be built.
        StorageError: the folder cannot be written.
    """
    scenario, out = as_scenario(scenario), Path(out)
    check_folder(out)
    energy = effective_energy_kev(scenario.source, scenario.detector)
    built = SimulationBuilder(scenario).specimen
    grid = scenario.reconstruction.volume_grid
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        for index, part in enumerate(built.parts):
            with complete(out / f"{index}-{part.name}.stl") as draft:
                exported: Any = part.mesh
                exported.export(draft)
        preview_specimen(built, out / "specimen.png", title=scenario.name)
        Volume(built.truth(grid, energy), grid).write(out / "truth.nii", "twinct truth, 1/mm")
    return built, energy


@kinds_checked
def write_urdf(
    scenario: Scenario | str | Path, out: str | Path, *, moveit: bool = False
) -> list[Path]:
    """Write a robot description of the operating room, and return its files.

    Args:
        scenario: the scenario, or its file.
        out: folder for cell.urdf and its meshes.
        moveit: write the arms and the room with its forbidden zones for MoveIt instead.

    Raises:
        InputError: the cell cannot be described.
        MissingExtraError: the extra ``robots`` is not installed.
        StorageError: the folder cannot be written.
    """
    scenario, out = as_scenario(scenario), Path(out)
    check_folder(out)
    require("robots")
    builder = SimulationBuilder(scenario)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        files = builder.moveit(out) if moveit else {"cell.urdf": builder.urdf(meshes=out)}
        for name, text in files.items():
            write_text(out / name, text)
    return [out / name for name in files]
