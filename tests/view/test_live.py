from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import viser
from listener import Listener

from twinct import run
from twinct.runs import Run
from twinct.scenario import Scenario
from twinct.view.folder import RunFolder
from twinct.view.following import Follower, LivePage
from twinct.view.page import Page


def files(store: Path) -> dict[str, bytes]:
    return {str(p.relative_to(store)): p.read_bytes() for p in store.rglob("*") if p.is_file()}


@pytest.fixture
def dead(server: viser.ViserServer) -> Iterator[socket.socket]:
    """A browser that connects and never reads."""
    with socket.create_connection(("127.0.0.1", server.get_port())) as made:
        made.sendall(
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            + f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n".encode()
        )
        yield made


def test_a_page_follows_its_run_and_changes_nothing(
    server: viser.ViserServer,
    dead: socket.socket,
    scenario: Scenario,
    finished: Run,
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    with closing(Page(server, live=True)) as page, closing(Listener(server.get_port())) as listener:
        live = LivePage(page, out)
        watched = run(scenario, out, link="local", observers=[live.observer])
        live.close()
        assert page.settle()
        assert files(watched.paths.scan) == files(finished.paths.scan)
        assert np.array_equal(watched.volume.array, finished.volume.array)

        listener.wait(lambda: "view 7 of 8" in listener.node("/label")["text"])
        texts = "\n".join(_told(message) for _, message in listener.heard)
        assert "planned" in texts
        assert "8 of 8 views" in texts
        # The arms moved. How many places a page paints depends on how busy the machine is.
        moves = [m for _, m in listener.heard if m["type"] == "SetPositionMessage"]
        hand = {tuple(m["position"]) for m in moves if "/room/source/" in m["name"]}
        assert len(hand) > 3
        shown = page.shows[0]
        assert np.array_equal(shown.volumes["reconstruction"].array, finished.volume.array)
        assert list(shown.geometries) == ["commanded", "executed", "believed"]


def _told(message: dict) -> str:
    return _content(message.get("updates", {}))


def test_a_folder_of_another_process_is_followed(
    server: viser.ViserServer, finished: Run, tmp_path: Path
) -> None:
    import shutil

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
        follower = Follower(page, 0, folder, show)
        with closing(Listener(server.get_port())) as listener:
            listener.wait(lambda: "view 1 of 8" in listener.node("/label")["text"])
            for view in range(2, 5):
                status[view].write_bytes(kept[view])
                listener.wait(
                    lambda view=view: f"view {view} of 8" in listener.node("/label")["text"]
                )
            shutil.rmtree(out)
            listener.wait(lambda: [c for c in listener.gui.values() if "is gone" in _content(c)])
        follower.close()
        # What was shown stays.
        assert page.shows[0].acquired == 5


def _content(control: dict) -> str:
    return str(control.get("_markdown") or "")
