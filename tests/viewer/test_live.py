from __future__ import annotations

import shutil
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import viser
from listener import Listener, recorded
from waiting import HANG_S

from twinct import run
from twinct.observers import Event, JointSample, PlanMade
from twinct.runs import Run
from twinct.scenario import Scenario
from twinct.viewer.following import FolderPoller, LivePage
from twinct.viewer.live_page import Page
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.server import Server, address


def files(store: Path) -> dict[str, bytes]:
    return {str(p.relative_to(store)): p.read_bytes() for p in store.rglob("*") if p.is_file()}


@pytest.fixture
def dead(server: Server) -> Iterator[socket.socket]:
    """A browser that connects and never reads."""
    with socket.create_connection(("127.0.0.1", server.get_port())) as made:
        made.sendall(
            f"GET {urlsplit(address(server)).path} HTTP/1.1\r\n".encode()
            + b"Host: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            + f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n".encode()
        )
        assert made.recv(12) == b"HTTP/1.1 101"
        yield made


def test_a_page_follows_its_run_and_changes_nothing(
    server: Server,
    dead: socket.socket,
    scenario: Scenario,
    finished: Run,
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    moments: list[JointSample] = []
    scene = server.get_scene_serializer()  # browsers are sent only the newest of many places
    with closing(Page(server, live=True)) as page, closing(Listener(address(server))) as listener:
        live = LivePage(page, out)

        def hear(event: Event) -> None:
            live.hear(event)
            if isinstance(event, PlanMade):
                listener.wait(lambda: "planned" in listener.texts())
            if isinstance(event, JointSample):
                moments.append(event)
                assert page.settle(HANG_S)  # else the next place takes its place

        observer = replace(live.observer, hear=hear, joints_hz=2.0, lossless=True)
        watched = run(scenario, out, link="local", observers=[observer])
        live.close()
        listener.catch_up(page)
        assert files(watched.paths.scan) == files(finished.paths.scan)
        assert np.array_equal(watched.volume.array, finished.volume.array)

        assert "view 7 of 8" in listener.node("/label")["text"]
        assert "8 of 8 views" in listener.texts()
        shown = page.shows[0]
        assert np.array_equal(shown.volumes["reconstruction"].array, finished.volume.array)
        assert list(shown.geometries) == ["commanded", "executed", "believed"]
        room = page.stages[0]._room
        assert room is not None
        sources = [body.name for body in room.bodies].index("source")
        wanted = [tuple(room.at(moment.position)[0][sources]) for moment in moments]
        views = {tuple(room.at(joints)[0][sources]) for joints in shown.joints}
    # The arms were drawn wherever they were, in this order.
    drawn = iter([place for place, _ in groupby(places_of(scene.serialize(), "/room/source/"))])
    assert all(place in drawn for place, _ in groupby(wanted))
    assert len(set(wanted) - views) > 8  # between the views, too


def places_of(scene: bytes, part: str) -> list[tuple[float, ...]]:
    """All places of a node, one after the other."""
    return [
        tuple(message["position"])
        for _, message in recorded(scene)
        if message["type"] == "SetPositionMessage" and part in message["name"]
    ]


def test_a_folder_of_another_process_is_followed(
    server: Server, finished: Run, tmp_path: Path
) -> None:
    out = tmp_path / "copy"
    shutil.copytree(finished.paths.path, out)
    status = [out / "scan.zarr" / "status" / f"c.{view}" for view in range(8)]
    kept = [file.read_bytes() for file in status]
    for file in status[2:]:
        file.unlink()
    folder = RunFolder(out)
    show = folder.look()
    with closing(Page(server, live=True)) as page:
        page.put(0, show)
        follower = FolderPoller(page, 0, folder, show)
        with closing(Listener(address(server))) as listener:
            listener.wait(lambda: "view 1 of 8" in listener.node("/label")["text"])
            for view in range(2, 5):
                status[view].write_bytes(kept[view])
                listener.wait(
                    lambda view=view: f"view {view} of 8" in listener.node("/label")["text"]
                )
            shutil.rmtree(out)
            listener.wait(lambda: "is gone" in listener.texts())
        follower.close()
        # What was shown stays.
        assert page.shows[0].acquired == 5
