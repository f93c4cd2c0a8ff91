"""A page ends at once, whatever its browser has left open."""

from __future__ import annotations

import socket
from contextlib import closing

from waiting import HANG_S

from twinct.viewer.server import LOOPBACK, close, serve


def test_a_connection_without_a_request_does_not_hold_up_the_end() -> None:
    server = serve(LOOPBACK, 0)
    ahead = socket.create_connection((LOOPBACK, server.get_port()), timeout=HANG_S)
    with closing(ahead):
        # The server takes connections in order: it has the first once it has answered the second.
        with socket.create_connection((LOOPBACK, server.get_port()), timeout=HANG_S) as second:
            second.sendall(b"GET /wrong HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert second.recv(5) == b"HTTP/"
        thread = server._websock_server._server_thread
        assert thread is not None and thread.is_alive()
        close(server)
        assert not thread.is_alive()
