"""The whole way in Chromium: open, move, path, image, small volume, save; and a newcomer's task."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import trimesh
from browser import Browser
from waiting import HANG_S

from twinct.design.draft import Draft
from twinct.design.kept import kept_beside
from twinct.design.page import DesignPage
from twinct.viewer.server import Server

pytestmark = [pytest.mark.browser, pytest.mark.process]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with closing(Browser()) as made:
        yield made


def test_a_scenario_is_designed_by_the_page_alone(
    browser: Browser, server: Server, small_file: Path, tmp_path: Path
) -> None:
    def says(text: str) -> None:
        browser.wait(lambda: text in browser.text(), f"the page does not say {text!r}")

    with closing(DesignPage(server, Draft.open(small_file), tmp_path / "workers")) as page:
        browser.open(page.page)
        says("12 of 12 views within reach")
        assert page.settle(HANG_S)

        # Run and cancel are seen without scrolling.
        for button in ("undo", "run", "cancel the run"):
            code = "return arguments[0].getBoundingClientRect().bottom <= window.innerHeight"
            assert browser.script(code, browser.button(button)), f"{button} is below the window"

        # Move: by typed numbers, into a place that the arms cannot reach from, and back.
        before = browser.drawn()
        browser.choose("body", "source arm")
        browser.type_numbers("position, mm", (2500, 0, 0))
        says("0 of 12 views within reach")
        browser.changes(before, least=200)
        browser.press("undo")
        says("12 of 12 views within reach")
        assert page.bench.draft.is_saved

        # The path.
        browser.number("views", 8)
        says("8 of 8 views within reach")

        # The image, the prices, the changed lines.
        browser.turn_to("Image")
        browser.number("view", 5)
        says("view 5, 48 x 32 pixels")
        browser.turn_to("Prices")
        says("motion time")
        browser.turn_to("Changes")
        says("--set trajectory.views=8")

        # A small volume.
        browser.press("small volume")
        says("small volume: fresh")
        browser.turn_to("Slices")
        browser.wait(lambda: page.page.shows[0].volumes, "no volume comes")
        assert page.settle(HANG_S)

        assert "views: 12" in small_file.read_text(encoding="utf-8")
        browser.press("save")
        says("small.yaml: saved")
        assert "trajectory: {views: 8} # few" in small_file.read_text(encoding="utf-8")
        assert browser.complaints() == []
        browser.leave()


def test_a_newcomer_puts_an_own_part_into_the_room(
    browser: Browser, server: Server, small_file: Path, tmp_path: Path
) -> None:
    """A new STL, the table out of the way, a path within reach, an image, a small volume, save."""

    def says(text: str) -> None:
        browser.wait(lambda: text in browser.text(), f"the page does not say {text!r}")

    part = trimesh.creation.annulus(r_min=20, r_max=40, height=60)
    stl = tmp_path / "my part.stl"
    part.export(stl)
    with closing(DesignPage(server, Draft.open(small_file), tmp_path / "workers")) as page:
        browser.open(page.page)
        says("12 of 12 views within reach")

        browser.open_folder("Choose")
        browser.upload(stl)
        says("my-part.stl: 80.0 x 80.0 x 60.0 mm")
        assert "path: small_files/my-part.stl" in page.bench.draft.text

        # Something that is no part is refused, and says why.
        (tmp_path / "none.stl").write_text("solid nothing")
        browser.upload(tmp_path / "none.stl")
        says("holds no triangles")

        browser.choose("body", "table")
        says("position, mm")
        browser.type_numbers("position, mm", (300, -40, -700))
        for key in ("moved_mm: [300, -40]", "top_z_mm: -700"):
            browser.wait(lambda key=key: key in page.bench.draft.text, "the table stays")

        # An arm out of the way: some views are dead; the page says why, and finds a better place.
        browser.choose("body", "source arm")
        says("position, mm")
        browser.type_numbers("position, mm", (1000, 0, -150))
        says("source arm: out of reach")
        browser.press("cure")
        says("accept")  # its words come before: "looking at the proposed state"
        browser.press("accept")
        browser.wait(lambda: len(page.bench.draft.edits) == 4, "it is not accepted")
        browser.press("undo")
        browser.press("undo")
        says("12 of 12 views within reach")

        browser.turn_to("Image")
        says("this view sees 100 % of the specimen")
        browser.press("small volume")
        says("small volume: fresh")
        browser.press("save")
        says("small.yaml: saved")
        assert "my-part" in small_file.read_text(encoding="utf-8")

        browser.press("run")
        says("finished in")
        assert page.settle(HANG_S)
        assert {"reconstruction", "truth"} <= {*page.page.shows[0].volumes}
        assert page.page.shows[0].acquired == 12
        assert (small_file.parent / "out" / "small" / "report.html").is_file()
        assert browser.complaints() == []
        browser.leave()


def test_a_killed_browser_leaves_draft_and_page(
    browser: Browser, server: Server, small_file: Path, tmp_path: Path
) -> None:
    with closing(DesignPage(server, Draft.open(small_file), tmp_path / "workers")) as page:
        for views in (9, 10, 11):
            killed = Browser()
            killed.open(page.page)
            killed.number("views", views)
            killed.kill()
            browser.wait(
                lambda views=views: f"views: {views}" in page.bench.draft.text, "the edit is lost"
            )
            kept = kept_beside(small_file)
            assert kept is not None and kept.edits[-1].values == {"trajectory.views": views}
        browser.open(page.page)
        browser.wait(
            lambda: "11 of 11 views within reach" in browser.text(), "the page does not answer"
        )
        # Edits of one number in a row are one edit, as while a slider is dragged.
        browser.press("undo")
        browser.wait(
            lambda: "12 of 12 views within reach" in browser.text(), "the edit is not undone"
        )
        assert browser.complaints() == []
        browser.leave()
