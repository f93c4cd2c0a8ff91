"""One contract for every rig: the link must not be seen in anything it returns."""

import json
from contextlib import closing

import numpy as np
import pytest
import trimesh

from twinct.core.errors import LinkError, MotionError
from twinct.geometry.wire import PosePairs, Reached
from twinct.link import RosRig, ros_rigs
from twinct.scan import LocalRig, SimulationBuilder, local_rig
from twinct.scenario import parse_scenario

pytestmark = [pytest.mark.ros, pytest.mark.process]

POSES = ("executed", "exposure", "before")
NUMBERS = (*POSES, "joint_names", "time_s", "clearance_mm", "since_middle_s")
ARRAYS = ("position", "velocity", "effort", "state")


PLATE = {
    "name": "plate",
    "shape": {"kind": "sphere", "radius_mm": 200},
    "material": {"mass_fractions": {"C": 1.0}, "density_g_cm3": 0.1},
}
PHYSICS = {
    "uncertainty": {"preset": "collaborative", "patient": {"nod_mm": 3.0}},
    "source": {
        "spectrum": {"kind": "tube", "kvp": 80},
        "exposure_ms": 8.0,
        "motion_samples": 2,
        "focal_spot": {"kind": "gaussian", "sigma_mm": 0.3, "samples": 2},
    },
    "detector": {
        **{"columns": 32, "rows": 24, "pixel_pitch_mm": 10.0},
        **{"noise": {"kind": "quantum"}, "readout": {"electronic_noise": 3.0}, "lag": 0.1},
    },
}


def assert_same(one: Reached, other: Reached) -> None:
    for name in NUMBERS:
        assert getattr(one, name) == getattr(other, name), name
    for name in ARRAYS:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


def take(rig, targets, first=0):
    """What a rig gives for the views from a first one on."""
    views = []
    with closing(rig):
        for view in range(first, len(targets)):
            reached = rig.move(view, targets[view])
            views.append((reached, rig.expose(view)))
    return views


def fake_local_rig(scenario, fakes, command):
    del command
    return LocalRig(
        fakes.FakeRobots(), fakes.FakeImager(scenario.detector.panel), scenario.detector.panel
    )


def fake_ros_rig(scenario, fakes, command):
    del fakes
    return RosRig(scenario, node_command=command)


@pytest.mark.parametrize("make", [fake_local_rig, fake_ros_rig])
def test_contract(make, scenario, targets, fakes, fake_command, notes):
    views, joints = [], []
    with closing(make(scenario, fakes, fake_command)) as rig:
        rig.listen(joints.append)
        with pytest.raises(ValueError, match="view 0 was not reached"):
            rig.expose(0)
        for view in range(3):
            reached = rig.move(view, targets[view])
            with pytest.raises(ValueError, match=f"view {view + 1} was not reached"):
                rig.expose(view + 1)
            views.append((reached, rig.expose(view)))
        ((source, detector),) = targets[3].sevens
        far = PosePairs.from_sevens([((fakes.REFUSED_X_M + 1, *source[1:]), detector)])
        with pytest.raises(MotionError):
            rig.move(3, far)
        rig.move(3, targets[3])
        notes.tell("short_arm", 1)
        with pytest.raises(MotionError, match="the source arm is too short") as caught:
            rig.move(4, targets[4])
        notes.tell("short_arm", 0)
        assert caught.value.arms == ("source",)
    rig.close()

    under_way = [sample for sample in joints if sample.effort[1] > 0]  # not those of the views
    times = [sample.time_s for sample in under_way[:3]]
    assert times == pytest.approx([1 / 3 - 0.1, 2 / 3 - 0.1, 0.9])
    for sample, (reached, _) in zip(under_way, views, strict=False):
        assert sample.joint_names == reached.joint_names
        assert (sample.position == reached.position - 0.5).all()
    for view, (reached, image) in enumerate(views):
        assert isinstance(reached, Reached)
        assert image.shape == scenario.detector.panel.shape and image.dtype == np.float32
        assert reached.executed.source[0].distance_mm(targets[view].source[0]) > 0, (
            "executed, not commanded"
        )
    images = [image.tobytes() for _, image in views]
    assert len(set(images)) == len(images), "each view has its own image"
    for (reached, image), (expected, expected_image) in zip(
        views, take(fake_local_rig(scenario, fakes, ()), targets[:3]), strict=True
    ):
        assert_same(reached, expected)
        assert image.tobytes() == expected_image.tobytes()
    if make is fake_ros_rig:
        with pytest.raises(LinkError, match="closed"):
            rig.move(3, targets[3])


@pytest.mark.tutorial
def test_real_engines_give_all_physics_the_same_bits_over_both_links_and_after_a_resume(short):
    """Compare both; less physics is in ``test_same_bytes.py`` and ``runs/test_planned.py``."""
    builder = SimulationBuilder(parse_scenario(json.loads(short.resolved()) | PHYSICS))
    targets, over_ros = builder.targets, ros_rigs()
    local = take(local_rig(builder, 0, None), targets)
    ros = take(over_ros(builder, 0, None), targets)
    state = local[1][0].state
    resumed = [
        take(make_rig(builder, 2, state), targets, first=2) for make_rig in (local_rig, over_ros)
    ]

    for expected, others in [(local, ros), *((local[2:], again) for again in resumed)]:
        for (reached, image), (reached_ros, image_ros) in zip(expected, others, strict=True):
            assert_same(reached, reached_ros)
            assert image.tobytes() == image_ros.tobytes()
    assert local[0][1].min() < 0.9 < local[0][1].max(), "the ball is in the image"


def test_nodes_take_the_built_specimen_instead_of_building_it_again(tmp_path):
    ball = tmp_path / "ball.stl"
    trimesh.creation.icosphere(3, 40).export(ball)
    scenario = parse_scenario(
        {
            "cell": {"kind": "gantry", "objects": [PLATE]},
            "xray": {"engine": "mesh"},
            "trajectory": {"kind": "arc", "views": 2, "longitude_range_deg": 10},
            "detector": {"columns": 8, "rows": 6, "pixel_pitch_mm": 40},
            "specimen": {"parts": [{"shape": {"kind": "mesh", "path": str(ball)}}]},
        }
    )
    builder = SimulationBuilder(scenario)
    expected = take(local_rig(builder, 0, None), builder.targets)
    trimesh.creation.icosphere(3, 20).export(ball)
    views = take(ros_rigs()(builder, 0, None), builder.targets)
    assert [image.tobytes() for _, image in views] == [image.tobytes() for _, image in expected]
    assert all(image.max() < 0.95 for _, image in views)  # no ray passes beside the plate
