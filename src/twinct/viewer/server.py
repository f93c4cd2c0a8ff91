"""A viser server that only this machine can reach, and that shares nothing.

viser listens on all addresses, takes the next port if one is in use, has a button that shares the
page on the internet, and admits pages of any site. This file reverses that, and is the only one
that uses viser's internals.
"""

from __future__ import annotations

import contextlib
import io
import ipaddress
import logging
import socket
from collections.abc import Iterator
from urllib.parse import urlsplit

import viser
from viser import _messages as messages
from viser.infra import WebsockClientConnection

from twinct.core.errors import InputError

log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
LOCAL_NAMES = ("localhost", LOOPBACK, "::1")


def serve(
    host: str, port: int, *, allow_network: bool = False, label: str = ""
) -> viser.ViserServer:
    """Start a server; ``close`` ends it.

    Args:
        host: address to listen on.
        port: port to listen on; 0 for any free one.
        allow_network: permit addresses other than loopback.
        label: label of the page's panel.

    Raises:
        InputError: the port is in use or forbidden, or the address does not belong to this machine,
            or is not loopback without ``allow_network``.
    """
    if not allow_network and not is_loopback(host):
        raise InputError(
            f"--host {host}: the page has no password, so it is for this machine only "
            f"({LOOPBACK}); --allow-network shows it to anyone who reaches this address"
        )
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port}: a port is a number from 0 to 65535")
    _require_free(host, port)
    with _quiet():
        server = viser.ViserServer(host=host, port=port, verbose=False, label=label)
    # Users need not know of connections without a valid handshake.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    if port and server.get_port() != port:  # another process was faster: viser took the next
        close(server)
        raise InputError(_in_use(port))
    _share_nothing(server)
    if not allow_network:
        _refuse_other_sites(server)
    return server


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


def address(server: viser.ViserServer) -> str:
    """Return the page's URL for browsers on this machine."""
    host = server.get_host()
    shown = "localhost" if host in (*LOCAL_NAMES, "0.0.0.0", "::") else host
    return f"http://{shown}:{server.get_port()}"


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
    """Hide the share button, and ignore its messages."""
    server.gui.configure_theme(show_share_button=False, show_logo=False, brand_color=(31, 96, 145))
    for kind in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(kind)


def _refuse_other_sites(server: viser.ViserServer) -> None:
    """Close connections that pages of other sites open from a browser on this machine.

    Browsers let any page open websockets to loopback, and a site may point its own name to
    loopback. The names in the request reveal both (RFC 6455, section 10.2).
    """
    inner = server._websock_server

    async def look(client: WebsockClientConnection) -> None:
        connection = inner._live_connections[client.client_id]
        headers = connection.request.headers if connection.request else {}
        names = [urlsplit(f"//{headers.get('Host', '')}").hostname]
        if origin := headers.get("Origin"):
            names.append(urlsplit(origin).hostname)
        if any(name not in LOCAL_NAMES for name in names):
            log.warning("refused a connection from a page of %s", origin or names[0])
            await connection.close(1008, "only for this machine")

    inner._client_connect_cb.insert(0, look)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress viser's own output."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
