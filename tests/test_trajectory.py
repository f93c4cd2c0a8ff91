"""Trajectories: the paper's figures, equal steps, panels upright, files of views."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter

from twinct.errors import TrajectoryError
from twinct.geometry import Panel
from twinct.scenario import AnyTrajectory
from twinct.trajectory import commanded_views, write_views

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


@pytest.mark.parametrize("kind", ["sinusoid", "circle", "arc", "helix"])
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


def test_file_of_views_reads_back_the_same_numbers(tmp_path) -> None:
    geometry = paper()[::50]
    write_views(tmp_path / "views.csv", geometry)
    assert views(kind="file", path=tmp_path / "views.csv") == geometry


def test_file_with_source_and_panel_only_gets_upright_panels(tmp_path) -> None:
    (tmp_path / "v.csv").write_text("# S, D\n300,0,0,-300,0,0\n0,300,0,0,-300,0\n")
    geometry = views(kind="file", path=tmp_path / "v.csv")
    np.testing.assert_allclose(geometry.u, [[0, 1, 0], [-1, 0, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no view"),
        ("a,b\n1,2,3\n", ":2: a view is 6 numbers"),
        ("1,2,3,4,5,6\n1,x,3,4,5,6\n", ":2: .*not a number"),
        ("300,x,0,-300,0,0\n", ":1: .*not a number"),  # no line of names: a slip of the pen
        ("1,2,3,1,2,3\n", ":1: source and panel coincide"),
        ("0,0,300,0,0,-300\n", ":1: the beam is vertical"),
        (f"# axes\n{BEAM},0,1,0,0,0,1\n\n{BEAM},0,1,0,0,0.6,0.8\n", ":4: u and v are not orth"),
        (f"{BEAM},0,1,0,0,0,2\n", ":1: v is not a unit vector"),
        (f"{BEAM},0,0,0,0,0,1\n", ":1: u is not a unit vector"),
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
