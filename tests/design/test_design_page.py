"""The page of ``twinct design``, as a browser without a screen sees it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import trimesh
from listener import Listener
from waiting import HANG_S, until

from twinct.core.errors import InputError
from twinct.design.draft import Draft, open_draft
from twinct.design.page import DesignPage
from twinct.viewer.room import Room
from twinct.viewer.server import Server, address

pytestmark = pytest.mark.process

UPLOAD = "upload STL, NIfTI or zipped DICOM"


@pytest.fixture
def page(server: Server, small_file: Path, tmp_path: Path) -> Iterator[DesignPage]:
    with closing(DesignPage(server, Draft.open(small_file), tmp_path / "workers")) as made:
        yield made


@pytest.fixture
def listener(page: DesignPage, server: Server) -> Iterator[Listener]:
    with closing(Listener(address(server))) as made:
        made.wait(lambda: "12 of 12 views within reach" in made.texts())
        yield made


def test_a_design_goes_from_opening_to_saving(
    listener: Listener, page: DesignPage, small_file: Path
) -> None:
    listener.wait(lambda: "smallest clearance" in listener.texts())
    listener.wait(lambda: listener.node("/design/sphere"))
    listener.wait(lambda: listener.node("/room/"))

    # The path.
    listener.set("views", 8)
    listener.wait(lambda: "8 of 8 views within reach" in listener.texts())
    assert "trajectory: {views: 8} # few" in page.bench.draft.text
    listener.wait(lambda: "- trajectory: {views: 12} # few" in listener.texts())
    assert "--set trajectory.views=8" in listener.texts()

    # The image of the slider's view.
    listener.set("view", 5)
    listener.wait(lambda: "view 5, 48 x 32 pixels" in listener.texts())

    # A base out of reach, typed; then back.
    listener.set("body", "source arm")
    listener.wait(lambda: listener.control("position, mm")["value"][0] == 850)
    for typed in (2.0, 25.0, 250.0, 2500.0):  # digit by digit, as a browser sends it
        listener.set("position, mm", (typed, 0.0, 0.0))
    listener.wait(lambda: "0 of 8 views within reach" in listener.texts())
    listener.wait(lambda: "no motion plan" in listener.texts())
    assert "base_position_mm: [2500, 0, 0]" in page.bench.draft.text
    listener.press("undo")
    listener.wait(lambda: "8 of 8 views within reach" in listener.texts())
    until(lambda: listener.control("position, mm")["value"][0] == 850, "the number comes back")

    before = small_file.read_text(encoding="utf-8")
    assert "views: 12" in before
    listener.press("save")
    listener.wait(lambda: "small.yaml: saved" in listener.texts())
    assert "trajectory: {views: 8} # few" in small_file.read_text(encoding="utf-8")
    assert page.settle(HANG_S)


def test_bodies_that_overlap_are_shown_where_they_were_put(
    listener: Listener, page: DesignPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms: list[Room] = []
    monkeypatch.setattr(page.page, "put_room", lambda run, room: rooms.append(room))
    listener.wait(lambda: "12 of 12 views within reach" in listener.texts())
    listener.set("body", "table")
    listener.wait(lambda: listener.control("position, mm")["value"][2] == -450)
    listener.set("position, mm", (700.0, 0.0, -450.0))
    listener.wait(lambda: "the source arm's pillar reaches" in listener.texts())
    listener.wait(lambda: "no motion plan" in listener.texts())
    assert page.settle(HANG_S)
    assert "12 of 12 views within reach" not in listener.texts()
    assert "moved_mm: [700, 0]" in page.bench.draft.text
    table = next(body.mesh for body in rooms[-1].bodies if body.name == "table")
    assert table.bounds.mean(axis=0)[0] == pytest.approx(0.7)


def test_the_beam_is_set(listener: Listener, page: DesignPage) -> None:
    listener.wait(lambda: "12 of 12 views within reach" in listener.texts())
    listener.set("spectrum", "tube")
    listener.wait(lambda: "spectrum: {kind: tube, kvp: 120}" in page.bench.draft.text)
    listener.set("tube voltage, kV", 90)
    listener.wait(lambda: "kvp: 90" in page.bench.draft.text)
    listener.set("tube load, mAs a view", 0.5)
    listener.wait(lambda: "current_ma: 50" in page.bench.draft.text)
    listener.set("noise", True)
    listener.wait(lambda: "noise: {kind: quantum}" in page.bench.draft.text)
    assert page.bench.draft.problems == ()
    listener.press("undo")
    listener.wait(lambda: listener.control("noise")["value"] is False)


def test_a_dead_view_says_why(listener: Listener, page: DesignPage) -> None:
    listener.set("body", "source arm")
    listener.wait(lambda: listener.control("position, mm")["value"][0] == 850)
    listener.set("position, mm", (1400.0, 0.0, -300.0))
    listener.wait(lambda: "view 0: source arm: out of reach by" in listener.texts())
    listener.set("view", 5)
    until(lambda: not page.path._reason.visible, "a view within reach has no reason")
    with pytest.raises(InputError, match="the proposal is not asked"):
        page.bench.accept()


def test_an_upload_is_used_or_refused(
    listener: Listener, page: DesignPage, small_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=30).export(file_type="stl")
    assert isinstance(ball, bytes)
    listener.upload(UPLOAD, "ball.stl", ball)
    listener.wait(lambda: "ball.stl: 60.0 x 60.0 x 60.0 mm" in listener.texts())
    until(lambda: "small_files/ball.stl" in page.bench.draft.text, "it is not the specimen")
    listener.upload(UPLOAD, "other.stl", b"solid nothing")
    listener.wait(lambda: "other.stl: refused: part 'other'" in listener.texts())
    assert [one.name for one in small_file.with_name("small_files").iterdir()] == ["ball.stl"]
    listener.upload(UPLOAD, "ball.txt", b"x")
    listener.wait(lambda: "expected a file of a specimen" in listener.texts())
    # One that states more than is allowed is refused before any of it is kept.
    uuid = next(u for u, c in listener.gui.items() if c.get("label") == UPLOAD)
    told = {"source_component_uuid": uuid, "transfer_uuid": "t", "mime_type": ""}
    size = {"size_bytes": 2**40, "part_count": 2**21, "filename": "huge.nii"}
    listener.send({"type": "FileTransferStartUpload", **told, **size})
    listener.wait(lambda: "huge.nii: refused: it has 1099511627776 bytes" in listener.texts())
    assert not page.page.server.gui._current_file_upload_states


def test_the_gizmo_moves_a_body_by_steps(listener: Listener, page: DesignPage) -> None:
    listener.set("body", "specimen")
    listener.wait(lambda: listener.node("/design/gizmo"))
    until(lambda: page.move.gizmo.visible, "the gizmo is shown")
    page.move.gizmo.position = (0.0234, 0.0, -0.0051)
    page.move.drop()
    assert page.bench.draft.scenario is not None
    assert page.bench.draft.scenario.specimen.position_mm == (20, 0, -10)
    assert "position_mm: [20, 0, -10]" in page.bench.draft.text


def test_the_preview_gets_scatter_after_the_primary_image(
    server: Server, small_file: Path, tmp_path: Path
) -> None:
    text = small_file.read_text(encoding="utf-8")
    scatter = "pixel_pitch_mm: 6, scatter: {kind: monte_carlo, voxel_mm: 8}"
    small_file.write_text(text.replace("pixel_pitch_mm: 6", scatter), encoding="utf-8")
    draft = Draft.open(small_file)
    with (
        closing(DesignPage(server, draft, tmp_path / "workers", rest_s=3600.0)),
        closing(Listener(address(server))) as listener,
    ):
        for view in (0, 5):
            listener.set("view", view)
            listener.wait(
                lambda v=view: f"view {v}, 48 x 32 pixels (preview, w" in listener.texts()
            )


def test_a_change_by_another_program_is_said(
    listener: Listener, page: DesignPage, small_file: Path
) -> None:
    theirs = small_file.read_text(encoding="utf-8") + "seed: 9\n"
    small_file.write_text(theirs, encoding="utf-8")
    listener.wait(lambda: "Another program has changed the file" in listener.texts())
    listener.press("save")
    listener.wait(lambda: "another program has changed the file since" in listener.texts())
    assert small_file.read_text(encoding="utf-8") == theirs
    listener.press("take over")
    listener.wait(lambda: "small.yaml: saved" in listener.texts())
    assert page.bench.draft.scenario is not None and page.bench.draft.scenario.seed == 9


def test_a_small_volume_is_shown_in_slices(listener: Listener, page: DesignPage) -> None:
    listener.press("small volume")
    listener.wait(lambda: "small volume: fresh" in listener.texts())
    listener.wait(lambda: "reconstruction" in listener.control("slices of")["options"])
    listener.wait(lambda: np.asarray(listener.picture("/slices/z")).std() > 5)


def test_a_file_that_does_not_parse_is_shown_with_its_messages(
    server: Server, tmp_path: Path
) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text("trajectory: {views: [\n", encoding="utf-8")
    with (
        closing(DesignPage(server, Draft.open(path), tmp_path / "workers")),
        closing(Listener(address(server))) as listener,
    ):
        listener.wait(lambda: "not valid YAML" in listener.texts())


def test_a_name_of_a_built_in_scenario_begins_a_new_file(tmp_path: Path) -> None:
    draft = open_draft(Path("demo"), tmp_path)
    assert draft.path == tmp_path / "design.yaml" and not draft.path.exists()
    assert draft.scenario is not None and draft.scenario.name == "design"
