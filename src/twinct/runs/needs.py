"""What a run takes of the machine, told before it starts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinct.runs.acquisition import Link
from twinct.runs.volumes import memory_needed
from twinct.scan import Workshop
from twinct.scenario import Brain, CtVolume, Head, MeshFile, Scenario, Skull
from twinct.threads import threads

PROCESS_BYTES = 400 * 2**20
"""A process with its libraries and kernels, before it holds anything of the scan."""

ROOM_BYTES = 250 * 2**20
"""The room as a model, and the two arms in it."""

GVXR_BYTES = 2500 * 2**20
"""gVXR takes this when it is imported, and gives little of it back."""

SKULL_BYTES_PER_CELL = 40
SKULL_MM = 220.0
"""The built-in skull is cut out of a lattice of this edge, the brain out of a smaller one."""
HEAD_MM = 320.0
"""The same of the head."""

FILE_FACTOR = 24
"""Bytes in memory for each byte of a mesh or a compressed CT volume, at the peak."""

REPORT_BYTES = 300 * 2**20


@dataclass(frozen=True)
class Need:
    """What one stage takes, all processes of the run together.

    Attributes:
        memory_bytes: at the peak, an estimate from above.
        disk_bytes: that it leaves in the folder.
        threads: that compute at a time.
        processes: that are there.
    """

    memory_bytes: int
    disk_bytes: int = 0
    threads: int = 1
    processes: int = 1


def needs(scenario: Scenario, link: Link = "ros2") -> dict[str, Need]:
    """Bytes and threads of each stage of a run, before anything is built or rendered.

    The figures of the engines were measured with software OpenGL; specimens from files are told by
    the size of the files.

    Returns:
        In the order of the stages: ``specimen``, ``plan``, ``views``, ``truth``, ``reconstruction``
        and ``report``.
    """
    views = Workshop(scenario).asked  # what the plan may choose takes no bytes
    grid, panel = scenario.reconstruction.volume_grid, scenario.detector.panel
    voxels, image = math.prod(grid.shape), 4 * math.prod(panel.shape)
    number, many, local = len(views), threads(), link == "local"
    specimen = PROCESS_BYTES + _specimen_bytes(scenario)
    room = ROOM_BYTES if scenario.cell.kind == "arms" else 0
    simulations = room + GVXR_BYTES + 16 * image
    # Each node builds the specimen anew; in one process gVXR stays until the end.
    stays = GVXR_BYTES if local else 0
    acquiring = specimen + simulations if local else 3 * specimen + simulations
    scan, stored = 2 * number * image, (1 + len(scenario.detector.keep)) * number * image
    reconstructing = max(memory_needed(scenario, views).values())
    return {
        "specimen": Need(specimen),
        "plan": Need(specimen + room),
        "views": Need(acquiring, stored, many, 1 if local else 3),
        "truth": Need(specimen + stays + scan + 16 * voxels, 4 * voxels, many),
        "reconstruction": Need(specimen + stays + reconstructing, 4 * voxels, many),
        "report": Need(specimen + stays + scan + 9 * voxels + REPORT_BYTES, 8 * 2**20),
    }


def _specimen_bytes(scenario: Scenario) -> int:
    found = 0
    for part in scenario.specimen.parts:
        shape = part.shape
        if isinstance(shape, Skull | Head | Brain):
            edge = HEAD_MM if isinstance(shape, Head) else SKULL_MM
            cells = (edge * shape.scale / shape.mesh_resolution_mm) ** 3
            found += int(SKULL_BYTES_PER_CELL * cells)
        elif isinstance(shape, MeshFile | CtVolume):
            files = shape.path.rglob("*") if shape.path.is_dir() else [shape.path]
            found += FILE_FACTOR * sum(file.stat().st_size for file in files if file.is_file())
    return found
