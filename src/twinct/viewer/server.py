"""A viser server that only the owner of its address can use, and that shares nothing.

viser listens on all addresses, takes the next port if one is in use, has a button that shares the
page on the internet, and admits everybody with messages of any size. This file reverses that, and
is the only one that uses viser's internals.
"""

from __future__ import annotations

import contextlib
import io
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import viser
import websockets.asyncio.server
from viser import _messages as messages
from websockets.protocol import State

from twinct.core.errors import InputError
from twinct.viewer.guard import LARGEST_MESSAGE, LARGEST_PART, LOCAL_NAMES, Guard

LOOPBACK = "127.0.0.1"

_STARTING = threading.Lock()


class Server(viser.ViserServer):
    """A viser server that answers only requests that pass its guard.

    Attributes:
        guard: checks each request, for the page's file and for its data.
    """

    def __init__(self, host: str, port: int, guard: Guard, label: str, largest: int) -> None:
        """Start the server, which takes messages of at most ``largest`` bytes.

        Raises:
            RuntimeError: this version of viser starts it another way, without the guard.
        """
        self.guard = guard
        with _guarded(guard, largest) as started:
            super().__init__(host=host, port=port, verbose=False, label=label)
        self._started = started
        if not started:
            self.stop()
            raise RuntimeError(f"viser {viser.__version__} does not let requests be checked")

    def stop(self) -> None:
        """Stop at once: browsers open connections ahead, and send no request, for up to 10 s."""

        def end_idle() -> None:
            for server in self._started:
                for connection in server.handlers:
                    if connection.state is State.CONNECTING:
                        connection.transport.abort()

        with contextlib.suppress(RuntimeError):  # the loop has ended
            self.get_event_loop().call_soon_threadsafe(end_idle)
        super().stop()


@contextlib.contextmanager
def _guarded(guard: Guard, largest: int) -> Iterator[list[Any]]:
    """Guard the websocket servers that start in this block; yield them.

    viser passes no such options on to the library, so its function is replaced meanwhile.
    """
    started: list[Any] = []
    module: Any = websockets.asyncio.server
    with _STARTING:
        real = module.serve

        def serve(handler: Any, host: str, port: int, **options: Any) -> Any:
            check = guard.over(options.pop("process_request"))
            options["max_size"] = largest
            made = real(handler, host, port, process_request=check, **options)
            started.append(made.server)
            return made

        module.serve = serve
        try:
            yield started
        finally:
            module.serve = real


def serve(
    host: str, port: int, *, allow_network: bool = False, label: str = "", files: bool = False
) -> Server:
    """Start a server; ``close`` ends it.

    Args:
        host: address to listen on.
        port: port to listen on; 0 for any free one.
        allow_network: permit addresses other than loopback.
        label: label of the page's panel.
        files: permit messages with parts of files; ``accept_uploads`` then accepts these.

    Raises:
        InputError: the port is in use or forbidden, or the address does not belong to this machine,
            or is not loopback without ``allow_network``.
    """
    if not allow_network and not is_loopback(host):
        raise InputError(
            f"--host {host}: the page is for this machine only ({LOOPBACK}); --allow-network opens "
            "it to the network, unencrypted, for all who know its address"
        )
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port}: a port is a number from 0 to 65535")
    _require_free(host, port)
    with _quiet():
        largest = LARGEST_MESSAGE + (LARGEST_PART if files else 0)
        server = Server(host, port, _guard(host, allow_network), label, largest)
    # Users need not know of connections without a valid handshake.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    if port and server.get_port() != port:  # another process was faster: viser took the next
        close(server)
        raise InputError(_in_use(port))
    _share_nothing(server)
    return server


def _guard(host: str, allow_network: bool) -> Guard:
    names = {host.lower(), *LOCAL_NAMES}
    if allow_network:
        names.add(socket.gethostname().lower())
    return Guard(names, any_address=allow_network)


def accept_uploads(server: Server, most_bytes: int, refused: Callable[[str, str], object]) -> None:
    """Accept files from browsers, up to a size; without this call, all are ignored.

    A browser sends a file in parts, which are held until the last one has come.

    Args:
        server: the server.
        most_bytes: largest file, and the most bytes of all files that are under way.
        refused: called with the name of a larger file, and the reason.
    """
    gui, accept = server.gui, server.gui._handle_file_transfer_start

    def start(client: Any, message: messages.FileTransferStartUpload) -> None:
        under_way = sum(one["total_bytes"] for one in gui._current_file_upload_states.values())
        parts = -(-message.size_bytes // LARGEST_PART) if message.size_bytes >= 0 else -1
        if message.part_count == parts and message.size_bytes + under_way <= most_bytes:
            accept(client, message)
            return
        # The browser waits for the receipt of all parts before it sends another file.
        told = messages.FileTransferPartAck(
            source_component_uuid=message.source_component_uuid,
            transfer_uuid=message.transfer_uuid,
            transferred_bytes=message.size_bytes,
            total_bytes=message.size_bytes,
        )
        server._websock_server.queue_message(told)
        size = f"{message.size_bytes} bytes, the limit is {most_bytes}"
        refused(str(message.filename), f"it has {size}" if parts >= 0 else "it states no size")

    handlers = server._websock_server
    handlers.register_handler(messages.FileTransferStartUpload, start)
    handlers.register_handler(messages.FileTransferPart, gui._handle_file_transfer_part)


def close(server: viser.ViserServer) -> None:
    """End a server and its connections."""
    with _quiet():
        server.stop()


def is_loopback(host: str) -> bool:
    """Return True if an address is reachable only from this machine."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def address(server: Server) -> str:
    """Return the page's URL for browsers on this machine; who knows it can use the page."""
    host = server.get_host()
    shown = "localhost" if host in (*LOCAL_NAMES, "0.0.0.0", "::") else host
    shown = f"[{shown}]" if ":" in shown else shown
    return f"http://{shown}:{server.get_port()}/{server.guard.token}/"


def by_ssh(server: viser.ViserServer) -> str:
    """Return the SSH command with which another machine reaches the page."""
    port = server.get_port()
    return f"ssh -N -L {port}:localhost:{port} USER@{socket.gethostname()}"


def _require_free(host: str, port: int) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except PermissionError:
            raise InputError(f"--port {port}: only root may listen there") from None
        except OSError as error:
            if error.errno == 98:
                raise InputError(_in_use(port)) from None
            raise InputError(f"--host {host}: {error.strerror or error}") from None


def _in_use(port: int) -> str:
    return f"--port {port}: the port is in use: choose another, or 0 for any that is free"


def _share_nothing(server: viser.ViserServer) -> None:
    """Hide the share button, and ignore its messages and all files."""
    server.gui.configure_theme(show_share_button=False, show_logo=False, brand_color=(31, 96, 145))
    unwanted = (messages.ShareUrlRequest, messages.ShareUrlDisconnect)
    for kind in (*unwanted, messages.FileTransferStartUpload, messages.FileTransferPart):
        server._websock_server.unregister_handler(kind)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress viser's own output."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
