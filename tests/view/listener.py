"""A browser that draws nothing: a websocket client that keeps what the page has sent."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import viser
import websockets.sync.client
import zstandard
from PIL import Image

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


class Listener:
    """Connects to a page; ``nodes`` and ``gui`` are its state as a browser would have it."""

    def __init__(self, port: int, **headers: str) -> None:
        self.nodes: dict[str, dict[str, Any]] = {}
        self.gui: dict[str, dict[str, Any]] = {}
        self.theme: dict[str, Any] = {}
        self.heard: list[tuple[float, dict[str, Any]]] = []
        self._changed = threading.Condition()
        self._socket = websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
            compression=None,
            **headers,
        )
        with contextlib.suppress(websockets.ConnectionClosed):  # who is refused
            self.send(CAMERA)
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._socket.close()
        self._thread.join(5)

    @property
    def closed(self) -> bool:
        return not self._thread.is_alive()

    def wait(self, wanted: Callable[[], Any], timeout_s: float = 20.0) -> Any:
        """What ``wanted`` gives as soon as it gives anything."""
        with self._changed:
            self._changed.wait_for(lambda: _any(wanted), timeout_s)
            found = _any(wanted)
        assert found, "did not arrive"
        return found

    def node(self, part: str) -> dict[str, Any]:
        """The node with this in its name; the newest of several."""
        return [node for name, node in self.nodes.items() if part in name][-1]

    def picture(self, part: str) -> np.ndarray:
        """The pixels of an image node, (rows, columns, 3)."""
        return np.asarray(Image.open(io.BytesIO(self.node(part)["_data"])))

    def control(self, label: str) -> dict[str, Any]:
        return next(c for c in self.gui.values() if c.get("label") == label)

    def set(self, label: str, value: Any) -> None:
        """Move a control, as a browser does."""
        uuid = next(u for u, c in self.gui.items() if c.get("label") == label)
        self.gui[uuid]["value"] = value
        message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
        self._socket.send(msgspec.msgpack.encode(message))

    def press(self, button: str) -> None:
        """Press one of a group of buttons."""
        uuid = next(u for u, c in self.gui.items() if button in c.get("options", ()))
        message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": button}}
        self._socket.send(msgspec.msgpack.encode(message))

    def send(self, message: dict[str, Any]) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def _listen(self) -> None:
        try:
            for data in self._socket:
                assert isinstance(data, bytes)
                now = time.monotonic()
                with self._changed:
                    for message in decoded(data):
                        self.heard.append((now, message))
                        self._keep(message)
                    self._changed.notify_all()
        except websockets.ConnectionClosed:
            pass

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
