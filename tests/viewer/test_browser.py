"""The page in Chromium: each control changes the picture, and would be missed if it did not."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from browser import Browser
from viser.infra import StateSerializer
from waiting import until

from twinct.observers import Audience
from twinct.runs import Run
from twinct.scan import SimulationBuilder
from twinct.viewer.following import FolderPoller
from twinct.viewer.live_page import Page
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.server import LOOPBACK, address, close, serve
from twinct.viewer.show import Show
from twinct.viewer.single_file import VIEWS_A_SECOND, export_page
from twinct.viewer.stage import Stage

pytestmark = [pytest.mark.browser, pytest.mark.process]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with closing(Browser()) as made:
        yield made


@dataclass
class Tried:
    """What a check works with."""

    browser: Browser
    finished: Run
    builder: SimulationBuilder
    put: Callable[[Page, int, Show], None]
    folder: Path

    def show(self) -> Show:
        return RunFolder(self.finished.paths.path).look()

    @contextmanager
    def page(self, show: Show, *, live: bool = False) -> Iterator[Page]:
        """A page of the run, in the browser."""
        with ExitStack() as stack:
            server = serve(LOOPBACK, 0)
            stack.callback(close, server)
            page = stack.enter_context(closing(Page(server, live=live)))
            self.put(page, 0, show)
            stack.callback(self.browser.leave)
            self.browser.open(page)
            yield page


@pytest.fixture
def tried(
    browser: Browser,
    finished: Run,
    builder: SimulationBuilder,
    put: Callable[[Page, int, Show], None],
    tmp_path: Path,
) -> Tried:
    return Tried(browser, finished, builder, put, tmp_path)


def slider(tried: Tried) -> None:
    browser = tried.browser
    with tried.page(tried.show()):
        first = browser.still()
        browser.number("view", 5)
        browser.changes(first, least=2000)  # the arms are elsewhere
        browser.number("view", 0)
        browser.wait(lambda: _same(browser.drawn(), first), "the first view does not come back")


def play(tried: Tried) -> None:
    browser = tried.browser
    with tried.page(tried.show()) as page:
        first = browser.still()
        browser.press("play")
        browser.changes(first, least=2000)
        browser.changes(browser.picture(), least=2000)
        browser.press("pause")
        browser.wait(lambda: not page._playing, "it does not pause")
        browser.still()


def slices(tried: Tried) -> None:
    browser = tried.browser
    with tried.page(tried.show()):
        browser.choose("slices of", "truth")
        first = browser.still()
        browser.number("z", 3)
        browser.changes(first)


def geometry(tried: Tried) -> None:
    browser = tried.browser
    with tried.page(tried.show()):
        browser.number("magnify differences", 200)
        first = browser.still()
        browser.choose("beam and panel", "believed")
        browser.changes(first)


def live(tried: Tried) -> None:
    browser, out = tried.browser, tried.folder / "live"
    shutil.copytree(tried.finished.paths.path, out)
    status = [out / "scan.zarr" / "status" / f"c.{view}" for view in range(8)]
    kept = [file.read_bytes() for file in status]
    for file in status[1:]:
        file.unlink()
    folder = RunFolder(out)
    show = folder.look()
    with tried.page(show, live=True) as page, closing(FolderPoller(page, 0, folder, show)):
        first = browser.still()
        for file, data in list(zip(status, kept, strict=True))[1:6]:
            file.write_bytes(data)
        browser.changes(first, least=2000)  # nobody touched the page


def exported(tried: Tried) -> None:
    browser, page = tried.browser, tried.folder / "page.html"
    export_page(tried.show(), tried.builder, page, Audience())
    browser.open(page)
    first = browser.still()
    for _ in range(2):  # it plays by itself
        browser.pass_time(3 / VIEWS_A_SECOND)
        browser.changes(first, least=2000)
        first = browser.still()
    assert "slices" in browser.text() and "curves" in browser.text()


def _same(picture: np.ndarray, other: np.ndarray) -> bool:
    return bool((np.abs(picture - other) > 12).mean() < 0.002)


CHECKS: dict[str, Callable[[Tried], None]] = {
    check.__name__: check for check in (slider, play, slices, geometry, live, exported)
}


@pytest.mark.parametrize("check", CHECKS)
def test_each_control_does_what_it_says(check: str, tried: Tried) -> None:
    CHECKS[check](tried)
    assert tried.browser.complaints() == []


BROKEN = {
    "slider": (Page, "_look_again"),
    "play": (Page, "_step"),
    "slices": (Stage, "_draw_slice"),
    "geometry": (Stage, "_draw_beam"),
    "live": (FolderPoller, "_look"),
    "exported": (StateSerializer, "insert_sleep"),
}
"""What each needs: without it its check must fail."""

NOTICED = "the picture stays as it was|does not come back"


@pytest.mark.parametrize("check", BROKEN)
def test_a_page_broken_on_purpose_is_noticed(
    check: str, tried: Tried, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a picture must change, the page has come to what is broken, and has drawn the rest."""
    owner, name = BROKEN[check]
    asked: list[object] = []
    monkeypatch.setattr(owner, name, lambda *told: asked.append(told))
    browser, before = tried.browser, 0
    wait, still = browser.wait, browser.still

    def rests() -> np.ndarray:
        nonlocal before
        found = still()
        before = len(asked)
        return found

    def once(done: Callable[[], object], problem: str) -> None:
        if not re.search(NOTICED, problem):
            return wait(done, problem)
        if check == "live":  # which looks all the time: once more, now that there is something
            seen = len(asked)
            until(lambda: len(asked) > seen, "another look")
        elif check != "exported":  # which was written before
            until(lambda: len(asked) > before, "what is broken")
        still()
        assert done(), problem

    monkeypatch.setattr(browser, "still", rests)
    monkeypatch.setattr(browser, "wait", once)
    with pytest.raises(AssertionError, match=NOTICED):
        CHECKS[check](tried)


def test_names_of_a_stranger_run_no_script(tried: Tried) -> None:
    show = tried.show()
    bad = "<img src=x onerror=window.ran=1>"
    renamed = replace(
        show,
        name=bad,
        state=bad,
        problems=(bad,),
        poses={**show.poses, bad: show.poses["believed"]},
        volumes={**show.volumes, bad: next(iter(show.volumes.values()))},
        residuals={**show.residuals, bad: (2.0, 1.0)},
    )
    browser = tried.browser
    with tried.page(renamed) as page:
        page.say(bad)
        browser.still()
        assert browser.text().count(bad) >= 4  # name, state, problem, said
        browser.choose("slices of", bad)
        browser.turn_to("Curves")
        browser.wait(lambda: browser.text().count(bad) >= 6, "no curves of it")
        browser.still()
        assert browser.script("return window.ran") is None
        browser.script("document.body.insertAdjacentHTML('beforeend', arguments[0])", bad)
        browser.wait(lambda: browser.script("return window.ran"), "it does not run as HTML either")


def test_pages_of_others_are_sent_nothing(tried: Tried) -> None:
    """Even if they know the token, in the browser that shows the page."""

    class Other(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<title>another page</title>")

        def log_message(self, format: str, *args: Any) -> None:
            pass

    with (
        closing(Page(server := serve(LOOPBACK, 0))),
        ThreadingHTTPServer((LOOPBACK, 0), Other) as other,
    ):
        Thread(target=other.serve_forever, daemon=True).start()
        page, port = address(server), other.server_port
        assert tried.browser.comes(page, page)
        for asking in (f"http://localhost:{port}", f"http://127.0.0.1:{port}"):
            assert not tried.browser.comes(page, asking)
        assert not tried.browser.comes(f"http://localhost:{server.get_port()}/", page)
        tried.browser.leave()
        other.shutdown()
    close(server)


def test_a_click_tells_numbers(tried: Tried) -> None:
    browser = tried.browser
    with tried.page(tried.show()):
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
