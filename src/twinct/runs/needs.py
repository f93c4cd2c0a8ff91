"""What a run takes of the machine, told before it starts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twinct.errors import MemoryShortageError
from twinct.memory import available_bytes
from twinct.runs.acquisition import Link
from twinct.runs.volumes import memory_needed
from twinct.scan import Workshop
from twinct.scenario import Brain, CtVolume, Head, MeshFile, Scenario, Shape, Skull
from twinct.specimen.shapes import triangles
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

BYTES_PER_TRIANGLE = 200
"""Of a body that is made, with what its library keeps of it; measured with ``ball_helix``."""

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


def require_memory(scenario: Scenario) -> None:
    """Refuse what this process could not hold even if it held nothing else, by its keys.

    A run needs more: ``needs`` estimates that from above, this tells of each thing from below.

    Raises:
        MemoryShortageError: one sentence for each thing that is too large.
    """
    available, limit = available_bytes()
    panel, views = scenario.detector.panel, len(Workshop(scenario).asked)
    pixels, grid = math.prod(panel.shape), scenario.reconstruction.volume_grid
    zoomed = scenario.reconstruction.zoom is not None
    told = {
        f"specimen.parts.{i}.shape: part {part.label!r}": _part_bytes(part.shape)
        for i, part in enumerate(scenario.specimen.parts)
    }
    told |= {
        f"detector.columns and detector.rows: images of {panel.columns} x {panel.rows} pixels": 16
        * pixels,
        f"trajectory: {views} views of {panel.columns} x {panel.rows} pixels": 8 * pixels * views,
        f"reconstruction.{'zoom' if zoomed else 'grid'}: {' x '.join(map(str, grid.shape_xyz))} "
        "voxels": 9 * math.prod(grid.shape),
    }
    if short := {what: size for what, size in told.items() if size > available}:
        raise MemoryShortageError(
            f"{what}: {size / 2**30:.3g} GiB of memory are needed at least, and "
            f"{available / 2**30:.2f} GiB are available ({limit})"
            for what, size in short.items()
        )


def _specimen_bytes(scenario: Scenario) -> int:
    return sum(_part_bytes(part.shape) for part in scenario.specimen.parts)


def _part_bytes(shape: Shape) -> int:
    if isinstance(shape, Skull | Head | Brain):
        edge = HEAD_MM if isinstance(shape, Head) else SKULL_MM
        return int(SKULL_BYTES_PER_CELL * (edge * shape.scale / shape.mesh_resolution_mm) ** 3)
    if isinstance(shape, MeshFile | CtVolume):
        files = shape.path.rglob("*") if shape.path.is_dir() else [shape.path]
        return FILE_FACTOR * sum(file.stat().st_size for file in files if file.is_file())
    return BYTES_PER_TRIANGLE * triangles(shape)
