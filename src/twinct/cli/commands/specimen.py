"""``twinct specimen``: meshes, truth and picture of a specimen."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Overrides, ScenarioFile
from twinct.cli.scenario_at import scenario_at
from twinct.runs.scenario_files import write_specimen


def specimen(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    set_: Overrides = (),
) -> None:
    """Build the specimen only: a mesh for each part, the voxel truth and a picture.

    Args:
        out: Folder for PART.stl, truth.nii and specimen.png.
    """
    with scenario_at(scenario, set_) as loaded:
        built, energy = write_specimen(loaded, out)
    table = Table("part", "material", f"mu at {energy:g} keV, 1/mm", "triangles", "volume, cm3")
    for part in built.parts:
        table.add_row(
            part.name,
            part.in_words,
            f"{part.mean_mu(energy):.5f}",
            f"{len(part.mesh.faces)}",
            f"{part.volume_mm3 / 1000:.1f}",
        )
    Console().print(table)
