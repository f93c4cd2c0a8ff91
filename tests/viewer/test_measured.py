"""An imported measured scan on the page: images, poses and volumes; no arms and no specimen."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ball_scan import PITCH, SDD, SOD, VIEWS, ball_images, orbit
from listener import Listener
from page_contents import alike, label, seen
from waiting import HANG_S

from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.measured import import_measured
from twinct.observers import Audience
from twinct.runs import reconstruct_run
from twinct.scan import NamedGeometry
from twinct.viewer.curves import curves
from twinct.viewer.filling import builder_of, fill, whole_room
from twinct.viewer.live_page import Page
from twinct.viewer.movie import frames
from twinct.viewer.numbers import of_pixel, of_view
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.server import Server, address
from twinct.viewer.show import Show
from twinct.viewer.single_file import export_page

MM = 1e-3

CIRCLE = {
    "kind": "circle",
    "sod_mm": SOD,
    "sdd_mm": SDD,
    "pitch_mm": PITCH,
    "angles": {"step": 360 / VIEWS},
    "rotates": "source",
    "direction": "counterclockwise",
    "rows": "up",
}


@pytest.fixture(scope="module")
def imported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an imported scan of the ball, without a volume."""
    folder = tmp_path_factory.mktemp("measured")
    np.save(folder / "images.npy", ball_images(orbit()))
    images = {"path": str(folder / "images.npy"), "values": "line_integrals"}
    grid = {"voxels": [40, 36, 24], "voxel_mm": 1.0}
    source = {"name": "ball", "images": images, "geometry": CIRCLE, "grid": grid}
    import_measured(source, folder / "ball")
    return folder / "ball"


@pytest.fixture(scope="module")
def folder(imported: Path) -> Path:
    """This scan with two volumes and a further geometry, 0.5 mm off along x."""
    folder = imported.with_name("judged")
    shutil.copytree(imported, folder)
    for keys in (["algorithm=sart", "iterations=3"], ["algorithm=fdk"]):
        reconstruct_run(folder, [f"reconstruction.{key}" for key in keys])
    stated = RunFolder(folder).look().first
    off = [
        tuple(Pose(one.position + (0.5, 0.0, 0.0), one.quat) for one in side)
        for side in (stated.source, stated.detector)
    ]
    NamedGeometry("shifted", PosePairs(*off), {"model": "shifted"}).write(folder / "geometries")
    return folder


@pytest.fixture
def show(folder: Path) -> Show:
    return RunFolder(folder).look()


def test_what_exists_is_shown(folder: Path, show: Show) -> None:
    assert not RunFolder(folder).under_way
    assert show.state == f"{VIEWS} of {VIEWS} views" and not show.problems
    assert show.acquired == len(show) == VIEWS
    assert list(show.geometries) == ["stated", "shifted"]
    np.testing.assert_allclose(show.geometries["stated"].source, orbit().source, atol=1e-9)
    assert set(show.volumes) == {"fdk", "sart"}
    assert show.scenario is show.cell is show.plan is builder_of(show) is None
    assert show.window()[1] > 0.02  # of the volume: there is no truth
    assert show.transmission is not None
    np.testing.assert_allclose(-np.log(show.transmission(5)), ball_images(orbit())[5], atol=1e-5)


def test_curves_are_residuals_and_distances_from_the_stated_poses(show: Show) -> None:
    errors, by_view, iterations = curves([show])
    assert errors.title == "distance from stated, mm"
    assert set(errors.series) == {"shifted, source", "shifted, panel"}
    np.testing.assert_allclose(errors.series["shifted, panel"], 0.5)
    assert set(by_view.series) == {"fdk", "sart"} and by_view.over_views
    assert all(len(values) == VIEWS and (values > 0).all() for values in by_view.series.values())
    assert set(iterations.series) == {"sart"} and len(iterations.x) == 3


def test_a_click_tells_numbers(show: Show) -> None:
    told = of_view(show, 4)
    assert "*stated*" in told and "distance from stated: 0.500 mm source, 0.500 mm panel" in told
    assert "gap" not in told and "not taken" not in told
    stated = show.geometries["stated"]
    pixel = stated.pixel_centres(4)[7, 11]
    ray = stated.source[4], pixel - stated.source[4]
    assert "column 11, row 7" in (of_pixel(show, stated[4], 4, *ray, 0.0) or "")


def test_a_scan_without_a_volume_says_so(imported: Path) -> None:
    show = RunFolder(imported).look()
    assert show.problems == (f"{imported} holds no volume yet; 'twinct reconstruct' makes one",)
    assert show.acquired == VIEWS and not show.volumes


def test_a_tube_that_would_hide_the_volume_is_left_out(show: Show) -> None:
    room = whole_room(show, None)
    assert room is not None and {body.name for body in room.bodies} == {"source", "detector"}
    near = [Pose(0.1 * one.position, one.quat) for one in show.first.source]
    assert (
        whole_room(replace(show, first=PosePairs(tuple(near), show.first.detector)), None) is None
    )


@pytest.fixture
def listener(server: Server, show: Show) -> Iterator[Listener]:
    with closing(Page(server)) as page:
        filling = fill(page, 0, show)
        filling.join(HANG_S)
        assert page.settle(HANG_S)
        with closing(Listener(address(server))) as made:
            made.wait(lambda: made.node("/projection"))
            yield made


def test_the_page_has_poses_images_and_slices(listener: Listener, show: Show) -> None:
    for view in (0, 9):
        listener.set("view", view)
        listener.wait(lambda view=view: f"view {view} of {VIEWS}" in label(listener))
        listener.wait(
            lambda view=view: alike(listener.picture("/projection"), seen(show, view)) > 0.99
        )
        source = show.geometries["stated"].source[view]
        ball = listener.node("/balls/stated")
        np.testing.assert_allclose(ball["position"], source * MM, atol=1e-6)
    names = [*listener.nodes]
    assert any("/room/source" in name for name in names)
    assert any("/slices/x" in name for name in names)
    assert not any("specimen" in name or "floor" in name for name in names)


def test_it_is_exported_and_filmed(folder: Path, show: Show, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert run_command(["view", str(folder), "--export", str(page)]) == 0
    assert page.read_text(encoding="utf-8").count("<img alt=") == 2  # slices and curves
    first, *_, last = frames(show, None)
    assert np.abs(first.astype(float) - last)[:, :860].mean() > 0.2  # source and panel have moved
    assert first[400:, 870:].std() > 20  # a slice


def test_a_scan_without_a_volume_is_exported(imported: Path, tmp_path: Path) -> None:
    export_page(RunFolder(imported).look(), None, tmp_path / "page.html", Audience())
    assert (tmp_path / "page.html").stat().st_size > 100_000


def test_a_plan_of_it_is_refused(imported: Path, tmp_path: Path) -> None:
    """Without its images there is nothing to show."""
    (tmp_path / "scan").mkdir()
    shutil.copy(imported / "scenario.yaml", tmp_path / "scan")
    with pytest.raises(InputError, match="is an imported scan"):
        RunFolder(tmp_path / "scan").look()
