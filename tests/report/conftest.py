"""A small run that never happened, with everything a report can show."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.evaluation import image_figures, pose_errors
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.geometry.wire import PosePairs
from twinct.report import ReportData, build_metrics, cross_sections
from twinct.scenario import parse_scenario, stage_digests
from twinct.trajectory import commanded_views

MU = 0.043


def shells(grid):
    """A crooked, hollow egg of bone with a hole: no symmetry hides a swapped axis."""
    x, y, z = grid.axes()
    z, y, x = z[:, None, None], y[None, :, None], x[None, None, :]
    outside = (x / 62) ** 2 + ((y + 6) / 74) ** 2 + ((z - 5) / 55) ** 2
    inside = (x / 55) ** 2 + ((y + 6) / 67) ** 2 + ((z - 5) / 48) ** 2
    hole = np.hypot(x - 25, z + 10) < 14
    return (((outside < 1) & (inside > 1) & ~(hole & (y < 0))) * MU).astype(np.float32)


def disturbed(rng, poses, distance, angle_deg):
    """Poses off by about a distance and an angle."""
    for pose in poses:
        shift = rng.standard_normal(3)
        shift *= distance * rng.uniform(0.8, 1.1) / np.linalg.norm(shift)
        turn = Rotation.from_rotvec(rng.normal(0, angle_deg / 1.7, 3), degrees=True)
        yield Pose(pose.position + shift, (turn * Rotation.from_quat(pose.quat)).as_quat())


def make_report(views=24, panel=(80, 60), voxels=48, description="A run that never happened."):
    rng = np.random.default_rng(7)
    columns, rows = panel
    scenario = parse_scenario(
        {
            "name": "egg",
            "description": description,
            "detector": {"columns": columns, "rows": rows, "pixel_pitch_mm": 320 / columns},
            "trajectory": {"kind": "sinusoid", "views": views},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 60}}]},
            "reconstruction": {
                "grid": {"voxels": voxels, "voxel_mm": 159 / voxels},
                "geometry": ["believed", "executed"],
            },
        }
    )
    commanded = PosePairs.from_geometry(
        commanded_views(scenario.trajectory, scenario.detector.panel)
    )
    executed = PosePairs(
        tuple(disturbed(rng, commanded.source, 0.87, 0.19)),
        tuple(disturbed(rng, commanded.detector, 0.76, 0.2)),
    )
    grid: VolumeGrid = scenario.reconstruction.grid.volume_grid
    truth = shells(grid)
    noise = rng.standard_normal(grid.shape, dtype=np.float32)
    volume = truth + 0.15 * MU * noise + 0.1 * truth * np.sin(grid.axes()[0] / 9).astype(np.float32)
    x, y, z = (axis / 79 for axis in grid.axes())
    roi = x**2 + y[:, None] ** 2 + (z**2)[:, None, None] < 0.9
    figures = image_figures(volume, truth, roi, MU, grid)
    clearance = 30 + 15 * np.sin(np.linspace(0, 5, views))
    metrics = build_metrics(
        views=views,
        reached=views,
        pose_errors=pose_errors(commanded, executed),
        clearance_mm=clearance,
        image={"believed": figures, "executed": figures},
        seconds={"plan": 3.1, "motion": 6.5, "xray": 80.2, "reconstruction": 960, "total": 1083.0},
        simulated_seconds=210.0,
        scenario_digest=stage_digests(scenario)["images"],
        residuals={"believed": [0.3, 0.1, 0.06], "executed": [0.3, 0.1, 0.05]},
    )
    u, v = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-0.75, 0.75, rows))
    egg = np.exp(-2.5 * np.sqrt(np.clip(0.5 - u**2 - 1.4 * (v - 0.1) ** 2, 0, None))).astype("f4")
    shown = np.linspace(0, views - 1, 4).astype(int)
    return ReportData(
        scenario=scenario,
        scenario_yaml='name: egg\nspecimen: <b>&amp; "raw"</b> https://example.org/x\n',
        metrics=metrics,
        commanded=commanded,
        executed=executed,
        panel=Panel(rows, columns, 320 / columns, 320 / columns),
        clearance_mm=clearance,
        projections=[(int(k), np.roll(egg, int(k) % 9, axis=1)) for k in shown],
        slices=cross_sections(volume, truth, roi, grid),
        mu_reference=MU,
        reference="bone",
    )


@pytest.fixture(scope="session")
def report():
    return make_report()
