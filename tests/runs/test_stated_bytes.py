"""Disk and memory that are stated before the work, against the bytes of the arrays themselves.

Numbers of rows, columns, views and voxels have no common divisor, so that no wrong product of them
equals the right one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from twinct import needs, run
from twinct.exchange import bundle_bytes
from twinct.geometry import Panel, VolumeGrid
from twinct.link.recording.recorder import BYTES_A_PIXEL
from twinct.link.xray_node import answer_bytes, image_bytes
from twinct.recon.algorithms import BUILT_IN
from twinct.recon.known_components import implant_bytes
from twinct.recon.memory import SPARE_BYTES, peak_bytes
from twinct.recon.metal import metal_bytes
from twinct.recon.moving import moving_bytes
from twinct.runs.needs import PROCESS_BYTES, REPORT_BYTES
from twinct.runs.volumes import memory_needed
from twinct.scenario import Scenario, parse_scenario
from twinct.specimen.displacement_map import COARSEST_MM, MAP_VOXELS
from twinct.trajectory import commanded_views

ROWS, COLUMNS, VIEWS = 17, 23, 3
VOXELS = 5, 7, 11
IMAGES = "transmission", "raw", "flat", "dark"


def scenario(keep: tuple[str, ...] = (), views: int = VIEWS, **keys: Any) -> Scenario:
    detector = {"columns": COLUMNS, "rows": ROWS, "pixel_pitch_mm": 14, "keep": keep}
    if keep:
        detector["readout"] = {}
    return parse_scenario(
        {
            "cell": {"kind": "gantry"},
            "xray": {"engine": "mesh"},
            "trajectory": {"kind": "circle", "views": views},
            "detector": detector,
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 50}}]},
            "reconstruction": {"grid": {"voxels": list(VOXELS), "voxel_mm": 12}},
        }
        | keys
    )


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The bytes of disk that were asked for."""
    sizes: list[int] = []
    monkeypatch.setattr(
        "twinct.scan.store.require_space", lambda folder, size, what: sizes.append(size)
    )
    return sizes


def stored_images(folder: Path) -> int:
    """Bytes of the image arrays of a store, as Zarr holds them before compression."""
    group: Any = zarr.open_group(folder, mode="r")
    return sum(group[name].nbytes for name in IMAGES if name in group)


@pytest.mark.parametrize("keep", [(), ("raw", "flat", "dark")])
def test_a_scan_asks_for_the_disk_of_its_images_and_volumes(
    keep: tuple[str, ...], tmp_path: Path, asked: list[int]
) -> None:
    finished = run(scenario(keep), tmp_path / "run", link="local")
    images = stored_images(finished.paths.scan)
    assert images == (1 + len(keep)) * VIEWS * finished.scan.transmission[0].nbytes
    # The volume, its draft, and the truth.
    assert asked == [images + 3 * finished.volume.array.nbytes]
    assert needs(finished.scan.scenario, "local")["views"].disk_bytes == images


def test_each_stage_counts_the_arrays_that_it_holds() -> None:
    image = np.zeros((ROWS, COLUMNS), np.float32).nbytes
    volume = np.zeros(VOXELS, np.float32).nbytes
    few, more = (needs(scenario(views=number), "local") for number in (VIEWS, VIEWS + 2))
    small, wide = (
        needs(scenario(reconstruction={"grid": {"voxels": voxels, "voxel_mm": 12}}), "local")
        for voxels in (list(VOXELS), [VOXELS[0], VOXELS[1], VOXELS[2] + 1])
    )
    layer = 4 * VOXELS[0] * VOXELS[1]

    def grown(stage: str, what: str, one: Any, other: Any) -> int:
        return getattr(other[stage], what) - getattr(one[stage], what)

    # Transmission and line integrals of two more views.
    assert grown("truth", "memory_bytes", few, more) == 2 * 2 * image
    assert grown("report", "memory_bytes", few, more) == 2 * 2 * image
    assert grown("views", "disk_bytes", few, more) == 2 * image
    # Another layer of voxels, float32: truth with its parts, volume with the truth and two masks.
    assert grown("truth", "memory_bytes", small, wide) == 4 * layer
    assert grown("report", "memory_bytes", small, wide) == 9 * layer // 4
    for stage in ("truth", "reconstruction"):
        assert grown(stage, "disk_bytes", small, wide) == layer
        assert small[stage].disk_bytes == volume
    specimen = small["specimen"].memory_bytes
    assert specimen > PROCESS_BYTES
    engine = small["truth"].memory_bytes - specimen - 2 * VIEWS * image - 4 * volume
    assert small["views"].memory_bytes == specimen + engine + 16 * image
    assert (
        small["report"].memory_bytes
        == specimen + engine + 2 * VIEWS * image + 9 * volume // 4 + REPORT_BYTES
    )
    both = needs(scenario(), "ros2")
    assert both["views"].memory_bytes - small["views"].memory_bytes == 2 * specimen
    assert both["truth"].memory_bytes == small["truth"].memory_bytes - engine


def test_a_reconstruction_counts_the_scan_and_the_truth_beside_its_own_arrays() -> None:
    one = scenario()
    views = commanded_views(one.trajectory, one.detector.panel)
    (stated,) = memory_needed(one, views).values()
    pixels, voxels = VIEWS * ROWS * COLUMNS, math.prod(VOXELS)
    # ``sart``: one volume; transmission and line integrals, the truth and its mask.
    assert stated == 8 * pixels + 5 * voxels + 4 * voxels + SPARE_BYTES


def test_surroundings_count_the_wide_grid_twice_beside_scan_and_truth() -> None:
    around = {"margin_mm": 24, "voxel_mm": 24}
    grid = {"voxels": list(VOXELS), "voxel_mm": 12}
    one = scenario(reconstruction={"grid": grid, "surroundings": around})
    views = commanded_views(one.trajectory, one.detector.panel)
    coarse = one.reconstruction.volume_grid.with_voxels(24, 24)
    pixels, voxels = VIEWS * ROWS * COLUMNS, math.prod(VOXELS)
    # The volume, two wide ones, the line integrals, and those in coarser pixels.
    least = 4 * (voxels + 2 * math.prod(coarse.shape) + pixels)
    stated = memory_needed(one, views)["surroundings"] - (8 * pixels + 5 * voxels)
    # The shadow of a voxel of 24 mm covers two or three pixels of 14 mm along each edge.
    coarser = {VIEWS * (ROWS // n) * (COLUMNS // n) for n in (2, 3)}
    assert (stated - least) / 4 in coarser


@pytest.mark.parametrize("name", BUILT_IN)
def test_an_algorithm_counts_its_volumes_and_projections(name: str) -> None:
    algorithm, volume = BUILT_IN[name], np.zeros(1000, np.float32).nbytes
    assert peak_bytes(algorithm, 0, 0) == SPARE_BYTES
    both = peak_bytes(algorithm, 1000, 1000, 2, 3) - SPARE_BYTES
    assert both == int(volume * (algorithm.volumes + 2 + algorithm.projections + 3))
    more = peak_bytes(algorithm, 1000, 2000, 2, 3) - SPARE_BYTES
    assert more - both == pytest.approx(volume * (algorithm.projections + 3), abs=1)


@pytest.mark.parametrize(
    ("stated", "of_voxel", "of_pixel"),
    [(metal_bytes, 9, 4), (implant_bytes, 8, 12)],
    ids=["metal", "implants"],
)
def test_corrections_count_their_volumes_and_projections(
    stated: Callable[[int, int], int], of_voxel: int, of_pixel: int
) -> None:
    """Volumes of four bytes and a mask; as many projections as the corrections allocate."""
    assert stated(0, 0) == SPARE_BYTES
    assert stated(1000, 0) - SPARE_BYTES == 1000 * of_voxel
    assert stated(0, 1000) - SPARE_BYTES == 1000 * of_pixel
    assert stated(1000, 1000) - SPARE_BYTES == 1000 * (of_voxel + of_pixel)


def test_a_moving_projector_counts_two_volumes_and_the_maps_of_each_view() -> None:
    grid = scenario().reconstruction.volume_grid
    volumes = 2 * np.zeros(VOXELS, np.float32).nbytes
    assert moving_bytes(grid, 0) == volumes
    # In voxels of 12 mm a map has a node in each voxel: three shifts, float32, to and fro.
    assert moving_bytes(grid, VIEWS) - volumes == VIEWS * 2 * 3 * volumes // 2
    # In fine voxels, a node in every so many along each axis.
    fine = VolumeGrid((MAP_VOXELS, 2 * MAP_VOXELS, 3 * MAP_VOXELS), COARSEST_MM / MAP_VOXELS / 2)
    nodes = np.zeros((1, 2, 3, 3), np.float32)
    own = moving_bytes(fine, VIEWS) - 8 * math.prod(fine.shape)
    assert own == VIEWS * 2 * nodes.nbytes


def test_images_that_travel_have_the_bytes_of_their_arrays() -> None:
    panel = Panel(ROWS, COLUMNS, 1.0, 1.0)
    image, display = (np.zeros(panel.shape, kind) for kind in (np.float32, np.uint8))
    assert image_bytes(panel) == image.nbytes
    assert answer_bytes(panel) == image.nbytes + display.nbytes
    # A recording holds both, and a tenth for all else.
    assert BYTES_A_PIXEL == pytest.approx(1.1 * answer_bytes(panel) / image.size)


def test_an_export_counts_all_images() -> None:
    views = commanded_views(scenario().trajectory, Panel(ROWS, COLUMNS, 1.0, 1.0))
    images = np.zeros((VIEWS, ROWS, COLUMNS), np.float32)
    page = 4096  # of a file system, for the header of each image
    assert bundle_bytes(views) == images.nbytes + VIEWS * page + 2**20
