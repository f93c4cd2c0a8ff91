"""Choices are edits; profiles and shares are calls."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from twinct.design import choices
from twinct.design.bench import Bench
from twinct.design.draft import Draft
from twinct.design.movable import Movable, movables
from twinct.design.profiles import profile_of
from twinct.design.seen import SeenShare
from twinct.geometry import Panel, Pose
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell


@pytest.fixture
def draft(small_file: Path) -> Draft:
    return Draft.open(small_file)


def test_every_specimen_of_the_list_is_valid(draft: Draft) -> None:
    names = choices.specimen_names()
    assert {"skull", "of scenario patient_head", "of scenario head_screws"} <= {*names}
    for name in names:
        assert draft.scenario is not None
        draft.set(choices.of_specimen(draft.scenario, name))
        assert not draft.problems, name
        draft.undo()
    assert draft.text == draft.saved


def test_room_table_rail_and_arm_are_one_edit_each(draft: Draft) -> None:
    def cell() -> Cell:
        assert draft.scenario is not None and isinstance(draft.scenario.cell, Cell)
        assert not draft.problems
        return draft.scenario.cell

    def choose(of: Callable[..., Any], *values: object) -> None:
        before = len(draft.edits)
        draft.set(of(draft.scenario, *values))
        assert len(draft.edits) == before + 1
        assert of(draft.scenario, *values) == {}  # chosen already

    choose(choices.of_room, "operating")
    assert cell().room == "operating"
    choose(choices.of_table, False)
    assert not cell().table.present
    now = draft.scenario
    assert now is not None and "table" not in {one.name for one in movables(now)}
    choose(choices.of_rail, "source_arm", (-300.0, 400.0))
    rail = cell().source_arm.rail
    assert rail is not None and rail.range_mm == (-300, 400)
    choose(choices.of_rail, "source_arm", (-300.0, 500.0))
    choose(choices.of_rail, "source_arm", None)
    assert cell().source_arm.rail is None
    choose(choices.of_arm, "detector_arm", "lbr_iiwa14")
    assert cell().detector_arm.model == "lbr_iiwa14"


def test_a_material_is_that_of_a_part(draft: Draft) -> None:
    assert draft.scenario is not None
    assert choices.materials_of(draft.scenario) == {"0: sphere": "bone", "1: bump": "bone"}
    draft.set(choices.of_material(draft.scenario, "1: bump", "titanium"))
    assert [part.material for part in draft.scenario.specimen.parts] == ["bone", "titanium"]
    assert choices.of_material(draft.scenario, "7: none", "titanium") == {}


@pytest.mark.parametrize("room", choices.ROOMS)
def test_the_table_moves_but_does_not_turn(draft: Draft, room: str) -> None:
    def table() -> Movable:
        assert draft.scenario is not None and not draft.problems
        return next(one for one in movables(draft.scenario) if one.name == "table")

    draft.set({"specimen.position_mm": [3, 4, 0], "cell.room": room})
    x, y, _ = table().position_mm
    to = Pose.from_euler((x + 702, y - 1, -653), (0, 0, 30))
    moved = table().moved(to)
    assert moved == {"cell.table.moved_mm": [702, -1], "cell.table.top_z_mm": -653}
    assert "cell.table.moved_mm" not in table().moved(Pose.from_euler((x, y, -600), (0, 0, 0)))
    draft.set(moved)
    assert table().position_mm == pytest.approx((x + 702, y - 1, -653))
    assert table().moved(to) == {}
    snapped = table().moved(Pose.from_euler((x + 708, y - 1, -653), (0, 0, 0)), 10.0)
    assert set(snapped) == {"cell.table.moved_mm"}
    draft.set(snapped)
    assert table().position_mm[0] % 10 == pytest.approx(0)


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (-2.0, 1.0, 0.5)])
def test_a_rail_follows_the_gizmo(draft: Draft, axis: tuple[float, float, float]) -> None:
    def seen() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Middle of the rail, mm, its direction, and the arm's base, mm, in MuJoCo's model."""
        assert draft.scenario is not None and not draft.problems
        assert isinstance(draft.scenario.cell, Cell)
        model = SimulationBuilder(draft.scenario).cell_of(draft.scenario.cell).model
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        track = data.geom("source_track")
        return 1000 * track.xpos, track.xmat[::3].copy(), 1000 * data.body("source_carriage").xpos

    def move(by: np.ndarray, turn_deg: float = 0.0) -> None:
        assert draft.scenario is not None
        rail = next(one for one in movables(draft.scenario) if one.name == "source rail")
        turned = Pose.from_euler((0, 0, 0), (0, 0, turn_deg)) @ rail.pose
        draft.set(rail.moved(Pose(rail.pose.position + by, turned.quat), 0.0, 0.0))

    draft.set({"cell.source_arm.rail": {"range_mm": [-300, 500], "axis": list(axis)}})
    middle, along, base = seen()
    assert along @ axis > 0.99 * np.linalg.norm(axis)
    for by, carried in ((-150 * along, 0.0), (20 * np.cross(along, (0, 0, 1)), 1.0)):
        move(by)
        now = seen()
        np.testing.assert_allclose(now[0], middle + by, atol=0.01)
        np.testing.assert_allclose(now[1], along, atol=1e-6)
        np.testing.assert_allclose(now[2], base + carried * by, atol=0.01)
        middle, _, base = now
    move(np.zeros(3), 10.0)
    np.testing.assert_allclose(
        seen()[1], Pose.from_euler((0, 0, 0), (0, 0, 10)).rotation @ along, atol=1e-5
    )


def test_a_rail_moves_by_steps(draft: Draft) -> None:
    draft.set({"cell.source_arm.rail": {"range_mm": [-300, 500]}})
    assert draft.scenario is not None
    rail = next(one for one in movables(draft.scenario) if one.name == "source rail")
    assert rail.moved(rail.pose, 10.0, 5.0) == {}
    to = Pose(rail.pose.position + (0, 104.2, 0), rail.pose.quat)
    assert rail.moved(to, 10.0, 5.0) == {"cell.source_arm.rail.range_mm": [-200, 600]}
    to = Pose(rail.pose.position + (13.0, 2, 0), rail.pose.quat)
    assert rail.moved(to, 10.0, 5.0) == {"cell.source_arm.base_position_mm": [860, 0, 0]}


def test_a_profile_goes_through_the_nearest_pixels() -> None:
    panel = Panel(30, 40, 2.0, 3.0)  # 80 x 90 mm, shown with 4 x 3 pixels
    image = np.exp(-np.arange(12, dtype=np.float32).reshape(3, 4))
    along = profile_of(image, panel, "columns", 29.0, "line integral")
    assert along.index == 2
    np.testing.assert_allclose(along.place_mm, [-30, -10, 10, 30])
    np.testing.assert_allclose(along.values, [8, 9, 10, 11], rtol=1e-6)
    down = profile_of(image, panel, "rows", -1000.0, "transmission")
    assert down.index == 0
    np.testing.assert_allclose(down.place_mm, [-30, 0, 30])
    np.testing.assert_allclose(down.values, np.exp([-0.0, -4, -8]), rtol=1e-6)


def test_the_share_that_views_see_follows_the_panel(draft: Draft) -> None:
    draft.set({"specimen.parts": [{"shape": {"kind": "box", "size_mm": [40, 40, 40]}}]})
    whole = SeenShare(draft.source).answered(Bench())
    assert whole.by_all == 1 and (whole.by_view == 1).all() and len(whole.by_view) == 12
    draft.set({"detector": {"columns": 48, "rows": 10, "pixel_pitch_mm": 6}})
    part = SeenShare(draft.source).answered(Bench())
    # 60 mm of the panel show 30 mm of the middle, three quarters of the box; views from above and
    # below see other quarters.
    assert (abs(part.by_view - 0.75) < 0.1).all()
    assert 0.3 < part.by_all < part.by_view.min()
