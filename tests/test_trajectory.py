"""Trajectories: the paper's figures, equal steps, panels upright, files of views."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.spatial import cKDTree

from twinct.core.errors import TrajectoryError
from twinct.geometry import Panel
from twinct.scenario import AnyTrajectory
from twinct.trajectory import commanded_mas, commanded_views, leaves_roll, write_views

PANEL = Panel(480, 640, 0.5, 0.5)
BEAM = "300,0,0,-300,0,0"


def views(**keys):
    return commanded_views(TypeAdapter(AnyTrajectory).validate_python(keys), PANEL)


def paper():
    return views(kind="sinusoid", views=399)


def test_paper_path_has_its_length_and_ends() -> None:
    geometry = paper()
    steps = np.linalg.norm(np.diff(geometry.source, axis=0), axis=1)
    # chords are a little shorter than the arcs: 3.085 mm by docs/paper.md, 1227.66 mm in all
    assert steps.mean() == pytest.approx(1227.66 / 398, abs=2e-4)
    assert np.ptp(steps) < 1e-3
    np.testing.assert_allclose(np.linalg.norm(geometry.source, axis=1), 300)
    longitude = np.degrees(np.arctan2(geometry.source[:, 1], geometry.source[:, 0]))
    latitude = np.degrees(np.arcsin(geometry.source[:, 2] / 300))
    assert longitude[[0, -1]] == pytest.approx([-105, 105])
    assert latitude.max() == pytest.approx(30, abs=0.01)
    np.testing.assert_allclose(
        latitude, 30 * np.sin(2 * np.pi * (longitude + 105) / 210), atol=1e-3
    )


@pytest.mark.parametrize(
    "kind",
    ["sinusoid", "circle", "arc", "helix", "saddle", "spiral", "uniform", "circle_arc"],
)
def test_panel_faces_the_source_upright(kind: str) -> None:
    geometry = views(kind=kind, views=11, isocentre_mm=[5, -7, 9])
    beam = geometry.source - geometry.detector
    np.testing.assert_allclose(np.linalg.norm(beam, axis=1), 600)
    np.testing.assert_allclose(geometry.normal, beam / 600, atol=1e-12)
    np.testing.assert_allclose(geometry.u[:, 2], 0, atol=1e-12)
    assert (geometry.v[:, 2] > 0).all()
    if kind != "helix":
        np.testing.assert_allclose(
            geometry.project([[5, -7, 9]])[:, 0],
            np.broadcast_to([319.5, 239.5], (11, 2)),
            atol=1e-9,
        )


def test_circle_closes_and_arc_includes_both_ends() -> None:
    circle = views(kind="circle", views=4, tilt_deg=0)
    np.testing.assert_allclose(circle.source[1], [0, 300, 0], atol=1e-9)
    arc = views(kind="arc", views=3, longitude_range_deg=180, latitude_deg=0)
    np.testing.assert_allclose(arc.source[[0, 2], 1], [-300, 300], atol=1e-9)


def test_helix_rises_by_its_pitch_each_turn() -> None:
    helix = views(kind="helix", views=21, turns=2, pitch_mm=40)
    assert helix.source[10, 2] - helix.source[0, 2] == pytest.approx(40)
    np.testing.assert_allclose(helix.source[:, 2], helix.detector[:, 2])


def angles(geometry):
    """Longitudes and latitudes of the source, degrees."""
    x, y, z = geometry.source.T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


def test_a_tilted_path_turns_about_its_axis_by_the_right_hand() -> None:
    flat = views(kind="arc", views=9, longitude_range_deg=180, latitude_deg=10)
    tilted = views(
        kind="arc",
        views=9,
        longitude_range_deg=180,
        latitude_deg=10,
        tilt_deg=30,
        tilt_axis_deg=90,
    )
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    about_y = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    np.testing.assert_allclose(tilted.source, flat.source @ about_y.T, atol=1e-9)
    circle = views(kind="circle", views=4, tilt_deg=20)
    np.testing.assert_allclose(angles(circle)[1], [0, 20, 0, -20], atol=1e-9)


def test_distances_may_change_along_the_path() -> None:
    geometry = views(kind="arc", views=5, sod_mm=[300, 400, 300], sdd_mm=[600, 800])
    sod = np.linalg.norm(geometry.source, axis=1)
    np.testing.assert_allclose(sod, [300, 350, 400, 350, 300])
    sdd = np.linalg.norm(geometry.source - geometry.detector, axis=1)
    np.testing.assert_allclose(sdd, [600, 650, 700, 750, 800])
    np.testing.assert_allclose(geometry.project([[0, 0, 0]])[:, 0], [[319.5, 239.5]] * 5)
    for kind in ("sinusoid", "circle", "helix", "saddle", "spiral", "uniform", "circle_arc"):
        geometry = views(kind=kind, views=7, sod_mm=[200, 300])
        across = np.linalg.norm(geometry.source - [0, 0, 0], axis=1)
        if kind == "helix":
            across = np.hypot(*geometry.source[:, :2].T)
        assert (np.diff(across) > 0).all() and 200 <= across.min() < across.max() <= 300


def test_distances_that_cross_are_refused_where_they_do() -> None:
    with pytest.raises(ValidationError, match=r"sdd_mm \(500\) must exceed sod_mm \(700\)"):
        views(kind="arc", views=5, sod_mm=[300, 700, 300], sdd_mm=[500, 500])


def test_several_turns_of_a_sinusoid_go_round() -> None:
    geometry = views(kind="sinusoid", views=800, longitude_range_deg=720, periods=3, phase_deg=90)
    longitude, latitude = angles(geometry)
    longitude = np.degrees(np.unwrap(np.radians(longitude)))
    assert np.ptp(longitude) == pytest.approx(720)
    wave = 30 * np.cos(2 * np.pi * 3 * (longitude - longitude[0]) / 720)
    np.testing.assert_allclose(latitude, wave, atol=1e-3)


def test_a_saddle_closes_and_is_met_by_every_plane_near_the_middle() -> None:
    saddle = views(kind="saddle", views=360, latitude_amplitude_deg=30, centre_longitude_deg=20)
    longitude, latitude = angles(saddle)
    np.testing.assert_allclose(latitude, 30 * np.cos(2 * np.radians(longitude - 20)), atol=1e-3)
    step = np.linalg.norm(np.roll(saddle.source, -1, axis=0) - saddle.source, axis=1)
    assert np.ptp(step) < 0.01  # the last step, back to the first view, included
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = rng.uniform(-100, 100, 500)  # R sin(30 deg) is 150 mm; inside, every plane meets it
    height = saddle.source @ normals.T - offsets
    assert (np.ptp(np.sign(height), axis=0) == 2).all()
    flat = views(kind="circle", views=360).source @ normals.T - offsets
    assert not (np.ptp(np.sign(flat), axis=0) == 2).all()  # a circle misses some


def test_a_spiral_has_equal_steps_and_equal_rises() -> None:
    spiral = views(kind="spiral", views=500, turns=4, latitude_range_deg=[-60, 60])
    step = np.linalg.norm(np.diff(spiral.source, axis=0), axis=1)
    assert np.ptp(step) < 1e-3 * step.mean()
    longitude, latitude = angles(spiral)
    turned = np.degrees(np.unwrap(np.radians(longitude)))
    np.testing.assert_allclose(latitude, -60 + (turned - turned[0]) / 12, atol=1e-2)
    assert latitude[[0, -1]] == pytest.approx([-60, 60])


def test_uniform_views_are_as_many_in_equal_areas() -> None:
    geometry = views(kind="uniform", views=2000, latitude_range_deg=[-20, 60])
    longitude, latitude = angles(geometry)
    assert latitude.min() > -20 and latitude.max() < 60
    low, high = np.sin(np.radians([-20, 60]))
    rows = ((np.sin(np.radians(latitude)) - low) / (high - low) * 4).astype(int)
    columns = ((longitude + 180) / 90).astype(int)
    number = np.bincount(4 * rows + columns, minlength=16)
    np.testing.assert_allclose(number, 125, atol=6)  # 11 at random
    nearest = cKDTree(geometry.source).query(geometry.source, 2)[0][:, 1]
    each = np.sqrt(2 * np.pi * (high - low) * 300**2 / 2000)
    assert nearest.min() > 0.6 * each  # no two views near each other
    part = angles(views(kind="uniform", views=50, longitude_range_deg=90))[0]
    assert -45 <= part.min() < -35 and 35 < part.max() <= 45


def test_circle_and_arc_share_the_views() -> None:
    geometry = views(kind="circle_arc", views=20, arc_share=0.25, centre_longitude_deg=30)
    longitude, latitude = angles(geometry)
    np.testing.assert_allclose(latitude[:15], 0, atol=1e-9)
    assert len(np.unique(longitude[:15].round(6))) == 15
    np.testing.assert_allclose(longitude[15:], 30)
    np.testing.assert_allclose(latitude[15:], [-30, -15, 0, 15, 30], atol=1e-9)
    open_ = views(kind="circle_arc", views=2, longitude_range_deg=180)
    assert len(open_) == 2


def test_a_zone_upside_down_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"latitude_range_deg \(30, 10\)"):
        views(kind="spiral", views=5, latitude_range_deg=[30, 10])


def test_file_of_views_reads_back_the_same_numbers(tmp_path) -> None:
    geometry = paper()[::50]
    write_views(tmp_path / "views.csv", geometry)
    assert views(kind="file", path=tmp_path / "views.csv") == geometry


def test_a_file_of_views_may_have_mas(tmp_path) -> None:
    geometry, mas, file = paper()[::200], np.array([0.1, 1 / 3]), tmp_path / "views.csv"
    write_views(file, geometry[:2], mas)
    assert views(kind="file", path=file) == geometry[:2]
    section = TypeAdapter(AnyTrajectory).validate_python({"kind": "file", "path": str(file)})
    np.testing.assert_array_equal(commanded_mas(section), mas)
    assert not leaves_roll(section)
    file.write_text(f"{BEAM},0.5\n")
    np.testing.assert_array_equal(commanded_mas(section), [0.5])
    assert leaves_roll(section)
    write_views(file, geometry)
    assert commanded_mas(section) is None


@pytest.mark.parametrize("pitch_mm", [0.5, 0.01])
def test_a_file_in_metres_is_refused_with_that_suspicion(tmp_path, pitch_mm: float) -> None:
    (tmp_path / "v.csv").write_text("0.3,0,0,-0.3,0,0\n0,0.3,0,0,-0.3,0\n")
    section = TypeAdapter(AnyTrajectory).validate_python(
        {"kind": "file", "path": str(tmp_path / "v.csv")}
    )
    with pytest.raises(TrajectoryError, match="only 0.6 mm apart.* in metres"):
        commanded_views(section, Panel(480, 640, pitch_mm, pitch_mm))


def test_file_with_source_and_panel_only_gets_upright_panels(tmp_path) -> None:
    (tmp_path / "v.csv").write_text("# S, D\n300,0,0,-300,0,0\n0,300,0,0,-300,0\n")
    geometry = views(kind="file", path=tmp_path / "v.csv")
    np.testing.assert_allclose(geometry.u, [[0, 1, 0], [-1, 0, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no view"),
        ("a,b\n1,2,3\n", ":2: a view has 6 numbers"),
        ("1,2,3,4,5,6\n1,x,3,4,5,6\n", ":2: .*not a number"),
        ("300,x,0,-300,0,0\n", ":1: .*not a number"),  # no line of names: a slip of the pen
        ("1,2,3,1,2,3\n", ":1: source and panel coincide"),
        ("0,0,300,0,0,-300\n", ":1: the beam is vertical"),
        (f"# axes\n{BEAM},0,1,0,0,0,1\n\n{BEAM},0,1,0,0,0.6,0.8\n", ":4: u and v are not orth"),
        (f"{BEAM},0,1,0,0,0,2\n", ":1: v is not a unit vector"),
        (f"{BEAM},0,0,0,0,0,1\n", ":1: u is not a unit vector"),
        (f"{BEAM},2\n{BEAM},0\n", ":2: mAs is 0, but must be above 0"),
        (f"{BEAM},0,1,0,0,0,1,-3\n", ":1: mAs is -3, but must be above 0"),
        (f"{BEAM},inf\n", ":1: .*not finite"),
        (f"{BEAM},2\n{BEAM}\n", "some lines have 6 numbers, others 7; use one form"),
        (f"a,b,c,d,e,f,tilt\n{BEAM},2\n", ":1: the last of 7 columns must be mas, not 'tilt'"),
        (f"{BEAM},0,0,1,0,1,0\n", ":1: u x v points away from the source"),
    ],
)
def test_bad_files_are_named(tmp_path, text: str, message: str) -> None:
    (tmp_path / "v.csv").write_text(text)
    with pytest.raises(TrajectoryError, match=message):
        views(kind="file", path=tmp_path / "v.csv")


def test_each_line_with_bad_axes_is_named(tmp_path) -> None:
    file = tmp_path / "views.csv"
    file.write_text(f"{BEAM},0,1,0,0,0,1\n{BEAM},0,2,0,0,0,1\n{BEAM},0,1,0,0,1,0\n")
    with pytest.raises(TrajectoryError) as caught:
        views(kind="file", path=file)
    assert [problem.split(":")[1] for problem in caught.value.problems] == ["2", "3"]


def test_a_number_that_is_not_finite_is_named_as_such(tmp_path) -> None:
    file = tmp_path / "views.csv"
    file.write_text("1,2,3,4,5,nan\n1,2,3\n")
    with pytest.raises(TrajectoryError) as caught:
        views(kind="file", path=file)
    first, second = caught.value.problems
    assert first.endswith(":1: '1,2,3,4,5,nan' holds a number that is not finite")
    assert second.endswith("this line has 3")
