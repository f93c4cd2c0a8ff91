"""A browser that draws nothing: a websocket client that keeps what the page has sent."""

from __future__ import annotations

import contextlib
import io
import itertools
import re
import socket
import threading
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import msgspec
import numpy as np
import viser
import websockets.sync.client
import zstandard
from PIL import Image
from waiting import HANG_S

from twinct.viewer.guard import LARGEST_PART
from twinct.viewer.live_page import Page

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -2.0, 0.0),
    "fov": 1.0,
    "image_height": 600,
    "image_width": 800,
    "near": 0.01,
    "far": 100.0,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
"""Where it looks from: who has not said so is not heard."""

_MARKS = itertools.count()


class Listener:
    """Connects to a page; ``nodes`` and ``gui`` are its state as a browser would have it."""

    def __init__(
        self,
        page: str,
        note: Callable[[dict[str, Any]], object] | None = None,
        *,
        origin: str | None = None,
        port: int | None = None,
    ) -> None:
        """Connect to this machine, whatever name an address has.

        Args:
            page: the page's address.
            note: called with each message as it comes.
            origin: of the page that asks; None: no browser asks.
            port: the page's port, if it is not that of the address.
        """
        self.nodes: dict[str, dict[str, Any]] = {}
        self.gui: dict[str, dict[str, Any]] = {}
        self.theme: dict[str, Any] = {}
        self.heard: list[dict[str, Any]] = []
        self._note = note or self.heard.append
        self._changed = threading.Condition()
        self.closed = False
        self._socket = websockets.sync.client.connect(
            page.replace("http://", "ws://", 1),
            subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
            compression=None,
            open_timeout=HANG_S,
            close_timeout=HANG_S,
            ping_interval=None,
            origin=None if origin is None else websockets.Origin(origin),
            sock=socket.create_connection(("127.0.0.1", port or urlsplit(page).port), HANG_S),
        )
        with contextlib.suppress(websockets.ConnectionClosed):  # who is refused
            self.send(CAMERA)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._socket.close()
        self._thread.join(HANG_S)

    def wait(self, wanted: Callable[[], Any]) -> Any:
        """What ``wanted`` gives as soon as it gives anything."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or _any(wanted), HANG_S)
            found = _any(wanted)
        assert found, "did not arrive"
        return found

    def catch_up(self, page: Page) -> None:
        """Wait until it has heard all that the page was asked to show before."""
        assert page.settle(HANG_S)
        page.server.scene.add_frame(mark := f"/mark{next(_MARKS)}", show_axes=False)
        self.wait(lambda: mark in self.nodes)

    def until_closed(self) -> None:
        """Wait until the page has closed the connection."""
        with self._changed:
            assert self._changed.wait_for(lambda: self.closed, HANG_S), "still connected"

    def node(self, part: str) -> dict[str, Any]:
        """The node with this in its name; the newest of several."""
        with self._changed:
            return [node for name, node in self.nodes.items() if part in name][-1]

    def picture(self, part: str) -> np.ndarray:
        """The pixels of an image node, (rows, columns, 3)."""
        return np.asarray(Image.open(io.BytesIO(self.node(part)["_data"])))

    def control(self, label: str) -> dict[str, Any]:
        with self._changed:
            return next(c for c in self.gui.values() if c.get("label") == label)

    def texts(self) -> str:
        """What the page says beside its controls, as it is shown."""
        return re.sub(r"\\([^\w\s]|_)", r"\1", self.markdown())

    def markdown(self) -> str:
        """What it says there, as it is sent."""
        with self._changed:
            return "\n".join(str(c.get("_markdown") or "") for c in self.gui.values())

    def set(self, label: str, value: Any) -> None:
        """Move a control, as a browser does."""
        with self._changed:
            uuid = next(u for u, c in self.gui.items() if c.get("label") == label)
            self.gui[uuid]["value"] = value
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def press(self, button: str) -> None:
        """Press one of a group of buttons."""
        with self._changed:
            uuid = next(u for u, c in self.gui.items() if button in c.get("options", ()))
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": button}})

    def upload(self, label: str, name: str, content: bytes, part: int = LARGEST_PART) -> None:
        """Send a file, as a browser does."""
        with self._changed:
            uuid = next(u for u, c in self.gui.items() if c.get("label") == label)
        transfer, parts = f"transfer-{next(_MARKS)}", range(0, len(content), part)
        told = {"source_component_uuid": uuid, "transfer_uuid": transfer}
        start = {"filename": name, "mime_type": "", "size_bytes": len(content)}
        self.send({"type": "FileTransferStartUpload", **told, **start, "part_count": len(parts)})
        for k, at in enumerate(parts):
            one = {"part_index": k, "content": content[at : at + part]}
            self.send({"type": "FileTransferPart", **told, **one})

    def send(self, message: dict[str, Any]) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def _listen(self) -> None:
        try:
            for data in self._socket:
                assert isinstance(data, bytes)
                with self._changed:
                    for message in decoded(data):
                        self._note(message)
                        self._keep(message)
                    self._changed.notify_all()
        except websockets.ConnectionClosed:
            pass
        finally:
            with self._changed:
                self.closed = True
                self._changed.notify_all()

    def _keep(self, message: dict[str, Any]) -> None:
        kind, name = message["type"], message.get("name")
        if kind == "RemoveSceneNodeMessage":
            self.nodes = {n: v for n, v in self.nodes.items() if not f"{n}/".startswith(f"{name}/")}
        elif kind == "SetPositionMessage":
            self.nodes.setdefault(name, {})["position"] = np.array(message["position"])
        elif kind == "SetOrientationMessage":
            self.nodes.setdefault(name, {})["wxyz"] = np.array(message["wxyz"])
        elif kind == "SetSceneNodeVisibilityMessage":
            self.nodes.setdefault(name, {})["visible"] = message["visible"]
        elif kind == "SceneNodeUpdateMessage":
            self.nodes.setdefault(name, {}).update(message["updates"])
        elif kind == "GuiUpdateMessage":
            self.gui.setdefault(message["uuid"], {}).update(message["updates"])
        elif kind == "GuiRemoveMessage":
            self.gui.pop(message["uuid"], None)
        elif kind == "ThemeConfigurationMessage":
            self.theme = message
        elif kind.startswith("Gui") and "uuid" in message:
            values = {"value": message["value"]} if "value" in message else {}
            self.gui[message["uuid"]] = {**message.get("props", {}), **values, "kind": kind}
        elif name is not None and "props" in message:
            self.nodes.setdefault(name, {}).update({**message["props"], "kind": kind})


def _any(wanted: Callable[[], Any]) -> Any:
    try:
        return wanted()
    except (LookupError, StopIteration, TypeError):
        return None


def decoded(data: bytes) -> list[dict[str, Any]]:
    """The messages of a packet: 8 bytes each of two sizes, compressed msgpack, aligned arrays."""
    size = int.from_bytes(data[8:16], "little")
    packet = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))
    return with_arrays(packet, data, 16 + size)


def recorded(data: bytes) -> list[tuple[float, dict[str, Any]]]:
    """The messages that a scene's serializer has kept, with the seconds that it was told."""
    content = zstandard.ZstdDecompressor().decompressobj().decompress(data[8:])
    size = int.from_bytes(content[:8], "little")
    packet = msgspec.msgpack.decode(content[8 : 8 + size])
    return [(m[0], m[1]) for m in with_arrays(packet, content, 8 + size)]


def with_arrays(packet: dict[str, Any], data: bytes, start: int) -> list[Any]:
    """The messages with the arrays that stand behind them."""
    arrays: list[bytes] = []
    for length in packet["binaryBufferLengths"]:
        start = -(-start // 8) * 8
        arrays.append(data[start : start + length])
        start += length
    return [_filled(message, arrays) for message in packet["messages"]]


def _filled(value: Any, arrays: list[bytes]) -> Any:
    if isinstance(value, dict):
        if "__binary_index" in value:
            found = arrays[value["__binary_index"]]
            kind = value.get("dtype")
            return np.frombuffer(found, kind) if kind else found
        return {key: _filled(inner, arrays) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_filled(inner, arrays) for inner in value]
    return value
