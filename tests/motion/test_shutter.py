"""Motion blur: an image is the mean over the path that the arms really took."""

import numpy as np
import pytest

from twinct.geometry import Pose, ScanGeometry
from twinct.geometry.wire import PosePairs
from twinct.robots.motion import Shutter
from twinct.robots.motion.kinematics import site_pose
from twinct.scan import LocalRig, SimulationBuilder
from twinct.scenario import parse_scenario

EXPOSURE_MS = 60.0
SCENARIO = {
    "source": {"energy_kev": 10, "exposure_ms": EXPOSURE_MS, "motion_samples": 48},
    "detector": {"columns": 300, "rows": 21, "pixel_pitch_mm": 0.1},
    "trajectory": {"kind": "arc", "views": 30, "longitude_range_deg": 150},
    # A thin opaque plate nearer to the source: its edge, at y = 0, wanders over the panel.
    "specimen": {
        "parts": [
            {
                "shape": {"kind": "box", "size_mm": [0.05, 60, 60]},
                "material": "Au",
                "position_mm": [80, -30, 0],
            }
        ]
    },
    "motion": {"tolerance_mm": 4.0},
}
EDGE_SHARE = 0.02
"""Of the edge's width: the plate is 0.05 mm thick, and a pixel is one ray, not an area."""


def pose(x, quat=(0, 0, 0, 1.0)):
    return Pose(np.array([x, 0, 0]), np.array(quat))


def instant(x):
    return PosePairs.at(pose(x), pose(-x), pose(0))


def test_instants_are_the_middles_of_equal_parts():
    steps = [instant(x) for x in (0.0, 4.0, 8.0, 12.0, 16.0)]
    shutter = Shutter(exposure_s=0.007, samples=4)
    assert shutter.steps(0.002) == 4
    middle, instants = shutter.over(steps, 0.002)
    found = [source.position[0] for source in instants.source]
    np.testing.assert_allclose(found, np.array([1, 3, 5, 7]) / 8 * 14)
    assert middle.detector[0].position[0] == pytest.approx(-7)


def test_an_image_that_takes_no_time_takes_no_steps():
    shutter = Shutter(exposure_s=0.5)
    assert shutter.steps(0.002) == 0
    assert shutter.over([instant(3.0)], 0.002) == (instant(3.0), PosePairs())


def test_a_moving_edge_is_as_wide_as_the_executed_path_says(figure):
    builder = SimulationBuilder(parse_scenario(SCENARIO))
    panel = builder.scenario.detector.panel
    robots = builder.robots()
    view = min(range(8, 22), key=lambda i: abs(builder.targets[i].source[0].position[1]))
    for earlier in range(view):
        robots.move(earlier, builder.targets[earlier])
    # The path, noted at every step by another way than the one that makes the image.
    steps = []

    def note(data):
        steps.append([site_pose(data, site) for site in builder.cell.site_ids])

    target = builder.targets[view]
    reached = robots.move(view, target, on_step=note)
    path = steps[-round(EXPOSURE_MS / 2) - 1 :]
    travel = np.linalg.norm(path[-1][0].position - path[0][0].position)
    assert travel > 2.0
    geometry = ScanGeometry.from_poses([s for s, _ in path], [d for _, d in path], panel)
    columns, rows = geometry.project([[80, 0, 0.0]])[:, 0].T
    assert np.ptp(rows) < 5
    with builder.imager() as imager:
        image = imager.expose(reached.path)
    line = np.abs(np.diff(image[10].astype(float)))
    x = np.arange(len(line)) + 0.5
    weight = line / line.sum()
    width = np.sqrt(weight @ x**2 - (weight @ x) ** 2)
    assert line.sum() == pytest.approx(1, abs=0.01)
    # The continuous path, linear between its steps; a step of the sampled edge is one pixel wide.
    a, b = columns[:-1], columns[1:]
    centre = np.mean(a + b) / 2
    predicted = np.sqrt(np.mean(a * a + a * b + b * b) / 3 - centre**2 + 1 / 12)
    figure(f"travel {travel:.2f} mm: edge {width:.2f} px, predicted {predicted:.2f} px")
    assert predicted > 3
    assert width == pytest.approx(predicted, rel=EDGE_SHARE)

    assert weight @ x == pytest.approx(centre, abs=0.3)
    # Reconstruction hears of the middle of the exposure.
    middle = reached.executed.geometry(panel)
    in_the_middle = columns[len(columns) // 2]
    assert middle.project([[80, 0, 0]])[0, 0, 0] == pytest.approx(in_the_middle, abs=0.1)


def test_a_rig_takes_its_path_and_the_last_view_for_lag_after_a_resume_too():
    small = {"columns": 32, "rows": 24, "pixel_pitch_mm": 10.0, "lag": 0.3}
    noise = {"noise": {"kind": "snr", "snr": 100}}
    scenario = parse_scenario(
        SCENARIO
        | {
            "source": {"exposure_ms": 10, "motion_samples": 2},
            "detector": small | noise,
            "specimen": {
                "parts": [{"shape": {"kind": "sphere", "radius_mm": 60, "mesh_resolution_mm": 4}}]
            },
        }
    )
    builder = SimulationBuilder(scenario)

    def take(robots, first):
        with LocalRig(robots, builder.imager(), scenario.detector.panel) as rig:
            taken = []
            for view in range(first, 3):
                reached = rig.move(view, builder.targets[view])
                taken.append((reached, rig.expose(view)))
            return taken

    straight = take(builder.robots(), 0)
    assert straight[0][0].before is None
    robots = builder.robots()
    robots.restore(straight[1][0].state)
    resumed = take(robots, 2)
    assert resumed[0][0].exposure == straight[2][0].exposure
    assert resumed[0][0].before == straight[2][0].before
    assert np.array_equal(resumed[0][1], straight[2][1])
    # The last view's shadow is in the image: it shines through where nothing stands now.
    assert len(straight[2][0].exposure) == 2
