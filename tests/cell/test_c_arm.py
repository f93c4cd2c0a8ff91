"""A C-arm: which views it holds, with which angles, and what it must not touch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy

from twinct.core.errors import ScenarioError, TrajectoryError
from twinct.geometry import Pose
from twinct.robots.c_arm import CArmKinematics
from twinct.robots.cell import GantryClearance, build_gantry
from twinct.runs.checks import check_physics, findings
from twinct.scan import SimulationBuilder
from twinct.scenario import CArm, GantryCell, Scenario, parse_scenario

MACHINE: dict[str, Any] = {
    "sod_mm": 622.0,
    "sdd_mm": 1040.0,
    "radius_mm": 780.0,
    "rotation_deg": [-220, 220],
    "orbit_deg": [-40, 95],
    "lift_mm": [0, 430],
    "column_mm": 300.0,
}
UPRIGHT = {"kind": "circle", "sod_mm": 622, "sdd_mm": 1040, "tilt_deg": 90, "tilt_axis_deg": 0}
"""A circle in the plane x-z, about the patient's axis y."""


def scenario(trajectory: dict[str, Any], *objects: dict[str, Any], **machine: Any) -> Scenario:
    return parse_scenario(
        {
            "trajectory": trajectory,
            "cell": {"kind": "gantry", "c_arm": MACHINE | machine, "objects": objects},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 60}}]},
        }
    )


def views_at(rows: np.ndarray) -> list[tuple[Pose, Pose]]:
    """Views at rotation and orbit, deg, and lift, mm, by turns of a vector, as a drawing has it."""
    views = []
    for rotation, orbit, lift in rows:
        # Orbit first, about -x: it leans the panel, at +z, towards +y; then rotation about y.
        turn = scipy.spatial.transform.Rotation.from_rotvec([0, np.radians(rotation), 0])
        turn *= scipy.spatial.transform.Rotation.from_rotvec([-np.radians(orbit), 0, 0])
        frame = Pose(np.array([0.0, 0.0, lift]), turn.as_quat())
        source = frame @ Pose(np.array([0, 0, -622.0]), Pose.identity().quat)
        views.append((source, frame @ Pose.from_euler((0, 0, 418), (180, 0, 0))))
    return views


def test_angles_and_lift_of_views_are_found() -> None:
    """With its axis along +y and the beam upwards, as a drawing of the machine defines them."""
    kinematics = CArmKinematics(CArm.model_validate(MACHINE))
    rng = np.random.default_rng(62)
    rows = rng.uniform((-170, -35, 0), (170, 80, 430), (20, 3))
    rows = rows[np.argsort(rows[:, 0])]
    for row, view in zip(rows, views_at(rows), strict=True):
        joints = kinematics.joints([view])[0]
        found = np.array([*np.degrees(joints[:2]), joints[2]])
        assert found == pytest.approx(row, abs=1e-6)
        for made, given in zip(kinematics.tools(joints), view, strict=True):
            assert made.position == pytest.approx(given.position, abs=1e-6)
            assert made.rotation == pytest.approx(given.rotation, abs=1e-9)


def test_a_turn_beyond_half_a_circle_goes_on() -> None:
    """From -215 to 215 deg, the rotation never jumps, although directions repeat."""
    rows = np.stack([np.linspace(-215, 215, 87), np.zeros(87), np.zeros(87)], axis=1)
    joints = CArmKinematics(CArm.model_validate(MACHINE)).joints(views_at(rows))
    assert np.degrees(joints[:, 0]) == pytest.approx(rows[:, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("trajectory", "machine", "views", "message"),
    [
        ({"kind": "circle", "sod_mm": 622, "sdd_mm": 1040, "views": 8}, {}, [2], "needs angles"),
        (UPRIGHT | {"views": 10, "sdd_mm": 1000}, {}, range(10), r"one SDD.* asks for 1000.0 mm"),
        (UPRIGHT | {"views": 10, "isocentre_mm": [5, 0, 0]}, {}, range(10), "5.0 mm beside"),
        (
            UPRIGHT | {"views": 10, "isocentre_mm": [0, 0, 500]},
            {},
            range(10),
            "needs a lift of 500",
        ),
    ],
)
def test_views_that_it_cannot_hold_are_refused_and_named(
    trajectory: dict[str, Any], machine: dict[str, Any], views: list[int], message: str
) -> None:
    builder = SimulationBuilder(scenario(trajectory, **machine))
    with pytest.raises(TrajectoryError, match=message) as hit:
        check_physics(builder)
    assert set(views) <= set(hit.value.views)


def test_a_circle_about_the_patient_is_accepted_with_its_angles() -> None:
    built = scenario(UPRIGHT | {"views": 22})
    builder = SimulationBuilder(built)
    check_physics(builder)
    told = findings(builder)
    assert "a C-arm: rotation" in told["motion"] and "orbit 0.0 to 0.0" in told["motion"]
    assert "smallest clearance" in told


def wall(at: tuple[float, float, float]) -> dict[str, Any]:
    shape = {"kind": "box", "size_mm": (60, 60, 60)}
    return {"name": "lamp", "shape": shape, "position_mm": at}


@pytest.mark.parametrize(
    ("place", "body"),
    [
        ((-820, -100, 0), "c arm"),  # beside the C's inner edge, when the C lies flat
        ((0, -1180, 0), "c arm lift"),  # where the column's arm is
        ((0, -1160, -800), "c arm column"),
    ],
)
def test_the_carrier_collides_with_the_room(place: tuple[float, float, float], body: str) -> None:
    """Source and panel alone, which float in the air, pass all of these places."""
    lamp = wall(place)
    floating = parse_scenario(
        {
            "trajectory": UPRIGHT | {"views": 22},
            "cell": {"kind": "gantry", "objects": [lamp]},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 60}}]},
        }
    )
    check_physics(SimulationBuilder(floating))
    builder = SimulationBuilder(scenario(UPRIGHT | {"views": 22}, lamp))
    with pytest.raises(TrajectoryError, match=f"gantry's {body} .*object lamp"):
        check_physics(builder)


def test_the_floor_and_the_specimen_are_in_its_way() -> None:
    low = scenario(UPRIGHT | {"views": 22})
    low = low.model_copy(update={"cell": low.cell.model_copy(update={"floor_z_mm": -800.0})})
    with pytest.raises(TrajectoryError, match="floor"):
        check_physics(SimulationBuilder(low))
    large = parse_scenario(
        {
            "trajectory": UPRIGHT | {"views": 22},
            "cell": {"kind": "gantry", "c_arm": MACHINE},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 410}}]},
        }
    )
    with pytest.raises(TrajectoryError, match="specimen"):
        check_physics(SimulationBuilder(large))


def test_a_body_between_two_views_is_found() -> None:
    """The C passes a bar that it touches at none of its views, 90 deg apart."""
    bar = wall((-800.0, 0.0, 0.0))
    built = scenario(UPRIGHT | {"views": 4, "centre_longitude_deg": 45}, bar)
    assert isinstance(built.cell, GantryCell)
    poses = [(source, panel) for source, panel, *_ in SimulationBuilder(built).commanded_poses]
    room = GantryClearance(built.cell, built.detector.panel, poses[0])
    assert min(room.at(pair).distance_mm for pair in poses) > 10
    with pytest.raises(TrajectoryError, match="on the way"):
        check_physics(SimulationBuilder(built))


def test_gaps_of_the_c_agree_with_a_mesh_of_it_anywhere() -> None:
    """A sphere against the formulas of boxes and cylinders, at random joints, built afresh."""
    ball = {"kind": "sphere", "radius_mm": 5}
    at = np.array([300.0, 350.0, 420.0])
    lamp = {"name": "lamp", "shape": ball, "position_mm": at.tolist()}
    keys = {"kind": "gantry", "c_arm": MACHINE, "objects": [lamp], "floor_z_mm": -9000}
    cell = GantryCell.model_validate(keys)
    rows = np.random.default_rng(7).uniform((-170, -35, 0), (170, 80, 300), (12, 3))
    panel = scenario(UPRIGHT | {"views": 4, "centre_longitude_deg": 45}).detector.panel
    views = views_at(rows)
    room = GantryClearance(cell, panel, views[0])
    hits = 0
    for view in views:
        fresh = build_gantry(cell, None, Pose.identity(), panel, *view).model
        gap, least = room.at(view), _nearest(fresh, at) - 5
        if gap.bodies[1] == "object lamp":
            hits += 1
            assert gap.distance_mm == pytest.approx(least, abs=0.01)
        else:  # the tube stands nearer to the sleeve
            assert gap.distance_mm < least
    assert hits >= 6


def _nearest(model: Any, point_mm: np.ndarray) -> float:
    """Distance of a point from the boxes and cylinders that move, by their formulas."""
    from twinct.robots.cell import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if name not in ("c_arm", "c_arm_sleeve", "c_arm_lift", "source", "detector"):
            continue
        if not model.geom_contype[geom]:
            continue
        local = data.geom_xmat[geom].reshape(3, 3).T @ (point_mm / 1e3 - data.geom_xpos[geom])
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            away = np.maximum(np.abs(local) - size, 0)
        else:
            radial = max(np.hypot(*local[:2]) - size[0], 0)
            away = np.array([radial, max(abs(local[2]) - size[1], 0)])
        found.append(float(np.linalg.norm(away)) * 1e3)
    return min(found)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"beam": [0, 1, 1]}, "perpendicular"),
        ({"radius_mm": 600}, "must exceed the distances"),
        ({"sdd_mm": 600}, "must exceed sod_mm"),
        ({"lift_mm": [10, 0]}, "must rise"),
        ({"orbit_deg": [0, 200]}, "must rise"),
    ],
)
def test_machines_that_cannot_be_are_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        scenario(UPRIGHT | {"views": 4, "centre_longitude_deg": 45}, **keys)


def test_the_live_page_moves_the_carrier_as_a_room_built_afresh() -> None:
    """Every body that moves, at other views than that of the room."""
    pytest.importorskip("mjviser")
    from twinct.viewer.room import GantryPlaces, Room

    cell = GantryCell.model_validate({"kind": "gantry", "c_arm": MACHINE})
    panel = scenario(UPRIGHT | {"views": 4, "centre_longitude_deg": 45}).detector.panel
    rows = np.array([(10, 5, 100), (-80, 30, 250), (140, -20, 0)], dtype=float)
    views = views_at(rows)

    def built(view: tuple[Pose, Pose]) -> Room:
        return Room(build_gantry(cell, None, Pose.identity(), panel, *view))

    room = built(views[0])
    places = GantryPlaces(room, *views[0], cell.c_arm)
    assert {"source", "detector", "c_arm", "c_arm_sleeve", "c_arm_lift"} <= places.moving
    for view in views:
        moved, fresh = places.at(*view), built(view).at(None)
        assert np.allclose(moved[0], fresh[0], atol=1e-6)
        aligned = np.abs((moved[1] * fresh[1]).sum(axis=1))
        assert np.allclose(aligned, 1, atol=1e-6)
