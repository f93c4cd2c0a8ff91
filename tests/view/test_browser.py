"""The page in Chromium: each control changes the picture, and would be missed if it did not."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
import viser
from browser import Browser
from viser.infra import StateSerializer

from twinct.observers import Audience
from twinct.runs import Run
from twinct.scan import Workshop
from twinct.view import export
from twinct.view.export import export_page
from twinct.view.filling import fill
from twinct.view.folder import RunFolder
from twinct.view.following import Follower
from twinct.view.page import Page
from twinct.view.server import LOOPBACK, close, serve
from twinct.view.stage import Stage

pytestmark = [pytest.mark.browser, pytest.mark.process]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with closing(Browser()) as made:
        yield made


def shown(stack: ExitStack, browser: Browser, finished: Run) -> viser.ViserServer:
    """A page of the run, served until the end."""
    server = serve(LOOPBACK, 0)
    stack.callback(close, server)
    page = stack.enter_context(closing(Page(server)))
    fill(page, 0, RunFolder(finished.paths.path).look()).join(60)
    assert page.settle()
    stack.callback(browser.leave)
    return server


def slider(browser: Browser, finished: Run, tmp_path: Path) -> None:
    with ExitStack() as stack:
        browser.open(shown(stack, browser, finished).get_port())
        first = browser.still()
        browser.number("view", 5)
        browser.changes(first, least=2000)  # the arms are elsewhere
        browser.number("view", 0)
        browser.wait(lambda: _same(browser.picture(), first), "the first view does not come back")


def play(browser: Browser, finished: Run, tmp_path: Path) -> None:
    with ExitStack() as stack:
        browser.open(shown(stack, browser, finished).get_port())
        first = browser.still()
        browser.press("play")
        browser.changes(first, least=2000)
        browser.changes(browser.picture(), least=2000)
        browser.press("pause")
        browser.still()


def slices(browser: Browser, finished: Run, tmp_path: Path) -> None:
    with ExitStack() as stack:
        browser.open(shown(stack, browser, finished).get_port())
        browser.choose("slices of", "truth")
        first = browser.still()
        browser.number("z", 3)
        browser.changes(first)


def geometry(browser: Browser, finished: Run, tmp_path: Path) -> None:
    with ExitStack() as stack:
        browser.open(shown(stack, browser, finished).get_port())
        browser.number("differences, times", 200)
        first = browser.still()
        browser.choose("beam and panel", "believed")
        browser.changes(first)


def live(browser: Browser, finished: Run, tmp_path: Path) -> None:
    out = tmp_path / "live"
    shutil.copytree(finished.paths.path, out)
    status = [out / "scan.zarr" / "status" / f"c.{view}" for view in range(8)]
    kept = [file.read_bytes() for file in status]
    for file in status[1:]:
        file.unlink()
    with ExitStack() as stack:
        server = serve(LOOPBACK, 0)
        stack.callback(close, server)
        page = stack.enter_context(closing(Page(server, live=True)))
        folder = RunFolder(out)
        show = folder.look()
        fill(page, 0, show).join(60)
        stack.enter_context(closing(Follower(page, 0, folder, show)))
        assert page.settle()
        stack.callback(browser.leave)
        browser.open(server.get_port())
        first = browser.still()
        for file, data in list(zip(status, kept, strict=True))[1:6]:
            file.write_bytes(data)
        browser.changes(first, least=2000)  # nobody touched the page


def exported(browser: Browser, finished: Run, tmp_path: Path) -> None:
    show = RunFolder(finished.paths.path).look()
    page = tmp_path / "page.html"
    # Eight views in less than a second begin anew too often for a renderer in software.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export, "VIEWS_A_SECOND", 0.5)
        export_page(show, Workshop(show.scenario, show.plan), page, Audience())
    browser.open(page)
    browser.changes(browser.picture(), least=2000)  # it plays by itself
    browser.changes(browser.picture(), least=2000)
    assert "slices" in browser.text() and "curves" in browser.text()


def _same(picture: np.ndarray, other: np.ndarray) -> bool:
    return bool((np.abs(picture - other) > 12).mean() < 0.002)


CHECKS: dict[str, Callable[[Browser, Run, Path], None]] = {
    check.__name__: check for check in (slider, play, slices, geometry, live, exported)
}


@pytest.mark.parametrize("check", CHECKS)
def test_each_control_does_what_it_says(
    check: str, browser: Browser, finished: Run, tmp_path: Path
) -> None:
    CHECKS[check](browser, finished, tmp_path)
    assert browser.complaints() == []


BROKEN = {
    "slider": (Page, "_look_again"),
    "play": (Page, "_step"),
    "slices": (Stage, "_draw_slice"),
    "geometry": (Stage, "_draw_beam"),
    "live": (Follower, "_look"),
    "exported": (StateSerializer, "insert_sleep"),
}
"""What each needs: without it its check must fail."""

NOTICED = "the picture stays as it was|does not come back"


@pytest.mark.parametrize("check", BROKEN)
def test_a_page_broken_on_purpose_is_noticed(
    check: str,
    browser: Browser,
    finished: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    owner, name = BROKEN[check]
    monkeypatch.setattr(owner, name, lambda *told: None)
    wait = browser.wait

    def soon(done: Callable[[], object], problem: str, timeout_s: float = 60.0) -> None:
        wait(done, problem, 6.0 if re.search(NOTICED, problem) else timeout_s)

    monkeypatch.setattr(browser, "wait", soon)
    with pytest.raises(AssertionError, match=NOTICED):
        CHECKS[check](browser, finished, tmp_path)


def test_a_click_tells_numbers(browser: Browser, finished: Run) -> None:
    with ExitStack() as stack:
        browser.open(shown(stack, browser, finished).get_port())
        browser.number("view", 4)
        browser.still()
        # Where the camera looks: what stands there is between the two side panels' middle.
        before = browser.text()
        assert "View 4 of 8" in before
        browser.click(0.546, 0.5)
        browser.wait(lambda: "View 4 of 8" not in browser.text(), "no numbers of what was clicked")
        told = browser.text()
        assert any(name in told for name in ("holder", "table", "slice across", "pixel column"))
    assert browser.complaints() == []
