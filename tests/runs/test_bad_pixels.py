"""Bad pixels: their map is kept with the scan, and reconstruction leaves them out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry.wire import PosePairs
from twinct.recon.projector import Projector
from twinct.runs import reconstruct
from twinct.scan import Scan, ScanStore, Simulated
from twinct.scenario import Scenario, load_scenario
from twinct.trajectory import commanded_views
from twinct.xray.build import build_bad_pixels
from twinct.xray.readout import mend_bad_pixels

KEYS = [
    *("cell={kind: gantry}", "trajectory.views=30", "trajectory.latitude_amplitude_deg=0"),
    *("trajectory.longitude_range_deg=360", "reconstruction.grid={voxels: 24, voxel_mm: 6}"),
    *("detector={columns: 40, rows: 32, pixel_pitch_mm: 8}", "reconstruction.geometry=executed"),
]
DEAD = "detector.bad_pixels={kind: random, share: 0.02}"
DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"


def blocks(shape: tuple[int, ...]) -> np.ndarray:
    """Bone in blocks of four voxels, one in three: edges everywhere."""
    rng = np.random.default_rng(3)
    coarse = rng.random([n // 4 for n in shape]) < 1 / 3
    return (0.04 * coarse.repeat(4, 0).repeat(4, 1).repeat(4, 2)).astype(np.float32)


def scan_of(scenario: Scenario) -> tuple[Scan, np.ndarray]:
    """Line integrals through blocks, dead pixels filled as the correction does it."""
    geometry = commanded_views(scenario.trajectory, scenario.detector.panel)
    grid = scenario.reconstruction.grid.volume_grid
    truth, poses = blocks(grid.shape), PosePairs.from_geometry(geometry)
    images = np.exp(-Projector(poses.geometry(scenario.detector.panel), grid)(truth))
    bad = build_bad_pixels(scenario.detector, scenario.seed)
    views = len(geometry)
    taken = Simulated(
        scenario=scenario,
        commanded=poses,
        executed=poses,
        executed_object=(poses.source[0],) * views,
        joint_names=(),
        joints=np.zeros((views, 0)),
        simulated_s=np.arange(float(views)),
        clearance_mm=np.full(views, np.nan),
    )
    mended = np.stack([mend_bad_pixels(image, bad) for image in images])
    return Scan(taken, mended, bad_pixels=bad if bad.any() else None), truth


LOST = 0.5
"""Share of the error of trusting filled pixels that leaving them out may have; measured 0.1."""


@pytest.mark.parametrize(
    ("algorithm", "iterations"),
    [
        ("sart", 4),
        pytest.param("os_sart", 6, marks=pytest.mark.tutorial),
        pytest.param("sirt", 20, marks=pytest.mark.tutorial),
        pytest.param("cgls", 14, marks=pytest.mark.tutorial),
    ],
)
def test_leaving_them_out_is_better_than_trusting_their_neighbours(
    algorithm: str, iterations: int, figure
) -> None:
    intact, truth = scan_of(load_scenario(DEMO, KEYS))
    scan, _ = scan_of(load_scenario(DEMO, [*KEYS, DEAD]))
    assert scan.bad_pixels is not None and 0.01 < scan.bad_pixels.mean() < 0.03

    def error(of: Scan) -> float:
        volume = reconstruct(of, algorithm=algorithm, iterations=iterations)
        return float(np.sqrt(np.mean((volume.array - truth) ** 2)) / truth.max())

    trusting = replace(scan, bad_pixels=None)
    least, left_out, filled = (100 * error(of) for of in (intact, scan, trusting))
    figure(f"{algorithm}: RMSE {least:.3f} % intact, {left_out:.3f} left out, {filled:.3f} filled")
    assert left_out - least < LOST * (filled - least)


def test_a_mask_of_ones_own_leaves_them_out_too() -> None:
    scan, _ = scan_of(load_scenario(DEMO, [*KEYS, DEAD, "reconstruction.iterations=1"]))
    assert scan.bad_pixels is not None
    half = np.ones(scan.bad_pixels.shape, dtype=bool)
    half[:16] = False
    both = reconstruct(replace(scan, bad_pixels=None), mask=half & ~scan.bad_pixels)
    np.testing.assert_array_equal(reconstruct(scan, mask=half).array, both.array)
    np.testing.assert_array_equal(
        reconstruct(scan).array,
        reconstruct(replace(scan, bad_pixels=None), mask=~scan.bad_pixels).array,
    )
    with pytest.raises(InputError, match="the mask has shape"):
        reconstruct(scan, mask=np.ones((3, 3), dtype=bool))


def test_the_store_keeps_their_map(tmp_path: Path) -> None:
    """As it was when the scan was begun: the file may go."""
    bad = np.zeros((32, 40), dtype=np.uint8)
    bad[3, 5:8] = 1
    np.save(tmp_path / "bad.npy", bad)
    file = f"detector.bad_pixels={{kind: file, path: {tmp_path / 'bad.npy'}}}"
    for keys, path in ((DEAD, tmp_path / "a"), (file, tmp_path / "b"), ("seed=2", tmp_path / "c")):
        scenario = load_scenario(DEMO, [*KEYS, keys])
        scan, _ = scan_of(scenario)
        store = ScanStore.create(path, scenario, scan.commanded, (), 15)
        if keys == file:
            (tmp_path / "bad.npy").unlink()
        if scan.bad_pixels is None:
            assert store.bad_pixels is None
        else:
            np.testing.assert_array_equal(store.bad_pixels, scan.bad_pixels)
