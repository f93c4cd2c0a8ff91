from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from urllib.parse import urlsplit

import numpy as np
import pytest
import viser
from listener import Listener
from page_contents import alike, label, seen
from waiting import HANG_S, until

from twinct.runs import Run
from twinct.viewer.live_page import Page
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.server import Server, address
from twinct.viewer.show import Show
from twinct.viewer.slices import Plane, greys

MM = 1e-3

Put = Callable[[Page, int, Show], None]

JPEG = 12.0
"""Mean difference of grey values that its compression leaves."""


@pytest.fixture
def show(finished: Run) -> Show:
    return RunFolder(finished.paths.path).look()


@pytest.fixture
def page(server: Server, show: Show, put: Put) -> Iterator[Page]:
    with closing(Page(server)) as made:
        put(made, 0, show)
        yield made


@pytest.fixture
def listener(server: Server, page: Page) -> Iterator[Listener]:
    with closing(Listener(address(server))) as made:
        made.wait(lambda: made.node("/projection"))
        yield made


def test_the_slider_shows_each_view_where_it_was_taken(
    listener: Listener, page: Page, show: Show
) -> None:
    executed = show.geometries["executed"]
    for view in (3, 7):
        listener.set("view", view)
        listener.wait(lambda view=view: f"view {view} of 8" in label(listener))
        listener.catch_up(page)
        assert alike(listener.picture("/projection"), seen(show, view)) > 0.99
        panel = listener.node("/projection")
        # Width along u and height along v; it stands 6 mm before the pixels' plane.
        front = executed.detector[view] + 6.0 * executed.normal[view]
        np.testing.assert_allclose(panel["position"], front * MM, atol=1e-6)
        w, x, y, z = panel["wxyz"]
        u = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        v = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        np.testing.assert_allclose((u, v), (executed.u[view], executed.v[view]), atol=1e-6)
        assert panel["render_width"] == pytest.approx(48 * 6.0 * MM)
        ball = listener.node("/balls/executed")
        np.testing.assert_allclose(ball["position"], executed.source[view] * MM, atol=1e-6)


def test_images_are_not_turned(listener: Listener, show: Show) -> None:
    """The specimen is asymmetric: no other way round looks as alike."""
    values, picture = seen(show, 0), listener.picture("/projection")
    assert alike(picture, values) > 0.99
    for other in (picture[::-1], picture[:, ::-1], picture[::-1, ::-1]):
        assert alike(other, values) < 0.95


def test_the_arms_stand_as_in_the_view(listener: Listener, page: Page, show: Show) -> None:
    room = page.stages[0]._room
    assert room is not None
    listener.set("view", 6)
    listener.wait(lambda: "view 6 of 8" in label(listener))
    listener.catch_up(page)
    positions, _ = room.at(show.joints[6])
    for body, position in zip(room.bodies, positions, strict=True):
        node = listener.node(f"/room/{body.name}/")
        np.testing.assert_allclose(node.get("position", np.zeros(3)), position, atol=1e-6)


def test_differences_are_magnified_about_executed(
    listener: Listener, page: Page, show: Show
) -> None:
    executed, believed = show.geometries["executed"], show.geometries["believed"]
    listener.set("beam and panel", "believed")
    listener.set("magnify differences", 50)
    listener.set("view", 4)
    shall = executed.source[4] + 50 * (believed.source[4] - executed.source[4])
    listener.wait(
        lambda: np.allclose(listener.node("/balls/believed")["position"], shall * MM, atol=1e-6)
    )
    listener.catch_up(page)
    front = executed.detector[4] + 50 * (believed.detector[4] - executed.detector[4])
    panel = listener.node("/projection")["position"] / MM
    # The panel of the believed geometry, magnified, with its 6 mm.
    assert np.linalg.norm(panel - front) == pytest.approx(6.0, abs=0.01)
    path = np.asarray(listener.node("/paths/believed/line")["points"]).reshape(-1, 2, 3)
    np.testing.assert_allclose(path[4, 0], shall * MM, atol=1e-5)


def test_slices_move_and_show_what_is_there(listener: Listener, show: Show) -> None:
    volume = show.volumes["truth"]
    listener.set("slices of", "truth")
    for axis, index in (("x", 16), ("y", 15), ("z", 13)):
        listener.set(axis, index)
        plane = Plane.of(volume.grid, "xyz".index(axis), index)
        shall = greys(plane.values(volume.array), show.window()).astype(float)

        def there(axis: str = axis, shall: np.ndarray = shall, plane: Plane = plane) -> bool:
            found = listener.picture(f"/slices/{axis}").astype(float)
            place = plane.world_from_plane.position * MM
            node = listener.node(f"/slices/{axis}")
            return np.abs(found - shall).mean() < JPEG and np.allclose(node["position"], place)

        listener.wait(there)
        assert shall.std() > 20  # the plane meets the specimen


def test_the_surface_comes_and_goes(listener: Listener) -> None:
    listener.set("surface of", "truth")
    listener.wait(lambda: len(listener.node("/surface")["vertices"]) > 100)
    listener.set("surface of", "nothing")
    listener.wait(lambda: not [name for name in listener.nodes if "/surface/" in name])


class Beats:
    """The time of play: the next view is due when the test says so."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._due = False
        self.awaited = False
        self.apart_s = 0.0

    def wait(self, beat_s: float) -> None:
        self.awaited, self.apart_s = True, beat_s
        self._page._changed.wait_for(lambda: self._page._wishes or self._due)
        self.awaited = False
        if not self._page._wishes:
            self._due = False

    def give(self) -> None:
        assert self._page.settle(HANG_S)
        with self._page._changed:
            self._due = True
            self._page._changed.notify_all()


def test_play_goes_on_and_stops(
    listener: Listener, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    beats = Beats(page)
    monkeypatch.setattr(page, "_await_beat", beats.wait)
    listener.set("views a second", 20)
    listener.press("play")
    for view in (1, 2, 3, 4, 5):
        beats.give()
        listener.wait(lambda view=view: f"view {view} of 8" in label(listener))
    assert page.settle(HANG_S)
    assert beats.awaited and beats.apart_s == 1 / 20
    listener.press("pause")
    listener.set("z", 5)
    until(lambda: page.look.slices[2] == 5, "what comes after the press")
    listener.catch_up(page)
    assert page.settle(HANG_S)
    assert not beats.awaited
    assert "view 5 of 8" in label(listener)


def test_a_second_browser_sees_the_same(listener: Listener, server: Server) -> None:
    listener.set("view", 5)
    with closing(Listener(address(server))) as second:
        second.wait(lambda: "view 5 of 8" in label(second))
        assert second.control("view")["value"] == 5
        second.set("view", 2)
        listener.wait(lambda: "view 2 of 8" in label(listener))
        assert listener.control("view")["value"] == 2


def test_a_browser_that_never_reads_holds_up_nobody(listener: Listener, server: Server) -> None:
    with socket.create_connection(("127.0.0.1", server.get_port())) as dead:
        dead.sendall(
            f"GET {urlsplit(address(server)).path} HTTP/1.1\r\n".encode()
            + b"Host: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            + f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n".encode()
        )
        assert dead.recv(12) == b"HTTP/1.1 101"
        for view in (1, 2, 3, 4):
            listener.set("view", view)
            listener.wait(lambda view=view: f"view {view} of 8" in label(listener))


def test_a_click_on_the_panel_says_the_pixel(page: Page, show: Show) -> None:
    executed = show.geometries["executed"]
    pixel = executed.pixel_centres(0)[20, 11] + 6.0 * executed.normal[0]
    eye = np.array([0.0, -1700.0, 500.0])
    page._select(0, "projection", "", eye, pixel - eye)
    assert "column 11, row 20" in page._numbers.content


def test_a_click_on_a_path_goes_to_its_view(page: Page, show: Show) -> None:
    eye = np.array([100.0, -1700.0, 500.0])
    page._select(0, "path", "executed", eye, show.geometries["executed"].source[5] - eye)
    assert page.settle(HANG_S)
    assert page.look.view == 5
    assert page._numbers.content.startswith("**View 5** of 8")


def test_two_runs_stand_side_by_side(server: Server, show: Show, put: Put) -> None:
    with closing(Page(server, 2)) as page:
        for run in (0, 1):
            put(page, run, show)
        with closing(Listener(address(server))) as listener:
            listener.wait(lambda: listener.node("/run1/projection"))
            listener.set("view", 3)
            listener.wait(lambda: "view 3" in listener.node("/run1/label")["text"])
            places = [listener.nodes[f"/run{run}"]["position"] for run in (0, 1)]
            assert np.linalg.norm(places[1] - places[0]) > 2.5
            assert "view 3" in listener.node("/run0/label")["text"]
