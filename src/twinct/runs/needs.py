"""Estimates of the memory, disk space, threads and time of a run, before it starts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from twinct.core.arguments import kinds_checked
from twinct.core.errors import MemoryShortageError
from twinct.core.foreign_text import quoted
from twinct.core.memory import available_bytes
from twinct.core.threads import threads
from twinct.runs.acquisition import Link
from twinct.runs.pilot import expected_time
from twinct.runs.volumes import memory_needed
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, as_scenario
from twinct.specimen.memory import moved_bytes, part_bytes, specimen_bytes
from twinct.xray.engines import engine_named

PROCESS_BYTES = 400 * 2**20
"""Memory of a process with its libraries and kernels, without any data of the scan."""

ROOM_BYTES = 250 * 2**20
"""Memory of the room's model with both arms."""

REPORT_BYTES = 300 * 2**20

COMPARED = 3
"""Volumes that a scan in sweeps keeps: of half the views, of the sweep between, and of all."""


STAGES_OF = {
    "specimen": ("specimen",),
    "plan": ("plan",),
    "views": ("link", "motion", "xray", "storing"),
    "truth": ("truth",),
    "reconstruction": ("reconstruction",),
    "report": ("judge", "report", "other"),
}
"""Timed stages of a run, by the stage whose needs they are."""


@dataclass(frozen=True)
class Need:
    """Resources of one stage, summed over all processes of the run.

    Attributes:
        memory_bytes: upper estimate of the peak memory.
        disk_bytes: size of the stage's files in the folder.
        threads: number of threads that compute at a time.
        processes: number of processes.
        seconds: expected time; None unless small scans of this kind were timed on this machine
            (``measured_time``).
    """

    memory_bytes: int
    disk_bytes: int = 0
    threads: int = 1
    processes: int = 1
    seconds: float | None = None


@kinds_checked
def needs(scenario: Scenario | str | Path, link: Link = "ros2") -> dict[str, Need]:
    """Estimate bytes, threads and time of each stage of a run, before anything is built.

    The memory of the engines was measured with software OpenGL; specimens from files are estimated
    by the size of the files.

    Returns:
        The stages in their order: ``specimen``, ``plan``, ``views``, ``truth``, ``reconstruction``
        and ``report``.
    """
    scenario = as_scenario(scenario)
    # Choices of the plan, such as an order, need no memory.
    views = SimulationBuilder(scenario).requested
    grid, panel = scenario.reconstruction.volume_grid, scenario.detector.panel
    voxels, image = math.prod(grid.shape), 4 * math.prod(panel.shape)
    number, many, local = len(views), threads(), link == "local"
    specimen = PROCESS_BYTES + specimen_bytes(scenario.specimen)
    moved = moved_bytes(scenario.specimen)
    room = ROOM_BYTES if scenario.cell.kind == "arms" else 0
    engine = engine_named(scenario.engine).memory_bytes if scenario.engine else 0
    simulations = room + engine + 16 * image
    # Each node builds its own specimen; in a single process, the engine stays until the end.
    stays = engine if local else 0
    acquiring = (specimen if local else 3 * specimen) + simulations + moved
    scan, stored = 2 * number * image, (1 + len(scenario.detector.keep)) * number * image
    reconstructing = max(memory_needed(scenario, views).values())
    if scenario.until is not None:  # volumes are made and compared while both simulations wait
        acquiring += reconstructing + 4 * voxels * COMPARED
    stages = {
        "specimen": Need(specimen),
        "plan": Need(specimen + room),
        "views": Need(acquiring, stored, many, 1 if local else 3),
        "truth": Need(specimen + moved + stays + scan + 16 * voxels, 4 * voxels, many),
        "reconstruction": Need(specimen + stays + reconstructing, 4 * voxels, many),
        "report": Need(specimen + stays + scan + 9 * voxels + REPORT_BYTES, 8 * 2**20),
    }
    time = expected_time(scenario, link)
    if time is None:
        return stages
    return {
        name: replace(need, seconds=sum(time.stages[stage] for stage in STAGES_OF[name]))
        for name, need in stages.items()
    }


def needs_in_words(scenario: Scenario, link: Link) -> dict[str, str]:
    """Return the memory, disk space and time of a run, in words by topic."""
    stages = needs(scenario, link)
    largest = max(stages, key=lambda name: stages[name].memory_bytes)
    disk = sum(need.disk_bytes for need in stages.values())
    time = expected_time(scenario, link)
    return {
        "memory": f"at most {stages[largest].memory_bytes / 2**30:.2g} GiB, in the stage {largest}",
        "disk": f"at most {disk / 1e6:.0f} MB" if disk < 1e9 else f"at most {disk / 1e9:.2f} GB",
        "time": time.in_words if time else "twinct check --time measures it, by small scans",
    }


def require_memory(scenario: Scenario) -> None:
    """Raise if a single part, image, scan or grid alone exceeds the available memory.

    These are lower bounds for each object; ``needs`` estimates the whole run from above.

    Raises:
        MemoryShortageError: one sentence for each object that is too large, with its keys.
    """
    available, limit = available_bytes()
    panel, views = scenario.detector.panel, len(SimulationBuilder(scenario).requested)
    pixels, grid = math.prod(panel.shape), scenario.reconstruction.volume_grid
    zoomed = scenario.reconstruction.zoom is not None
    data = {
        f"specimen.parts.{i}.shape: part {quoted(part.label)}": part_bytes(part.shape)
        for i, part in enumerate(scenario.specimen.parts)
    }
    data |= {
        f"detector.columns and detector.rows: images of {panel.columns} x {panel.rows} pixels": 16
        * pixels,
        f"trajectory: {views} views of {panel.columns} x {panel.rows} pixels": 8 * pixels * views,
        f"reconstruction.{'zoom' if zoomed else 'grid'}: {' x '.join(map(str, grid.shape_xyz))} "
        "voxels": 9 * math.prod(grid.shape),
    }
    if short := {what: size for what, size in data.items() if size > available}:
        raise MemoryShortageError(
            f"{what}: at least {size / 2**30:.3g} GiB of memory are needed, but only "
            f"{available / 2**30:.2f} GiB are available ({limit})"
            for what, size in short.items()
        )
