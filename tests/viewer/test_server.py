from __future__ import annotations

import socket
from contextlib import suppress

import pytest
import viser
from listener import Listener
from viser import _messages as messages
from waiting import HANG_S, until

from twinct.core.errors import InputError
from twinct.viewer.server import LOOPBACK, by_ssh, close, serve


def bound_to(server: viser.ViserServer) -> list[str]:
    """Whether each address of this machine answers on the server's port."""
    found, hosts = [], {"127.0.0.1"}
    with suppress(socket.gaierror):  # a bare machine may not know its own name
        hosts |= {i[4][0] for i in socket.getaddrinfo(socket.gethostname(), None)}
    for host in hosts:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
            probe.settimeout(HANG_S)
            if probe.connect_ex((host, server.get_port())) == 0:
                found.append(host)
    return found


def test_it_listens_on_loopback_and_shares_nothing(server: viser.ViserServer) -> None:
    assert server.get_host() == LOOPBACK
    assert all(host.startswith("127.") or host == "::1" for host in bound_to(server))
    handlers = server._websock_server._incoming_handlers
    assert messages.ShareUrlRequest not in handlers
    listener = Listener(server.get_port())
    listener.wait(lambda: listener.theme)
    assert listener.theme["show_share_button"] is False
    after = server.gui.add_checkbox("after", False)
    listener.wait(lambda: listener.control("after"))
    listener.send({"type": "ShareUrlRequest"})
    listener.send({"type": "ShareUrlDisconnect"})
    listener.set("after", True)
    until(lambda: after.value, "what was sent last")  # it lives, and is deaf to that
    assert server._share_tunnel is None
    listener.close()


def test_the_defaults_of_viser_are_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the test before would say nothing."""
    made = viser.ViserServer(port=0, verbose=False)
    try:
        assert made.get_host() == "0.0.0.0"
        assert messages.ShareUrlRequest in made._websock_server._incoming_handlers
    finally:
        close(made)


def test_a_port_in_use_is_refused(server: viser.ViserServer) -> None:
    with pytest.raises(InputError, match=f"--port {server.get_port()}: the port is in use"):
        serve(LOOPBACK, server.get_port())


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none_is_refused(port: int) -> None:
    with pytest.raises(InputError, match=f"--port {port}: a port is a number"):
        serve(LOOPBACK, port)


def test_the_network_is_opened_only_where_allowed() -> None:
    with pytest.raises(InputError, match="no password.*--allow-network"):
        serve("0.0.0.0", 0)
    with pytest.raises(InputError, match="--host 192.0.2.1"):
        serve("192.0.2.1", 0, allow_network=True)  # of no machine (RFC 5737)
    made = serve("0.0.0.0", 0, allow_network=True)
    try:
        assert made.get_host() == "0.0.0.0"
        assert messages.ShareUrlRequest not in made._websock_server._incoming_handlers
    finally:
        close(made)


def test_pages_of_other_sites_do_not_look_in(server: viser.ViserServer) -> None:
    server.scene.add_frame("/secret")
    stranger = Listener(server.get_port(), origin="http://example.org")
    renamed = Listener(server.get_port(), additional_headers={"Host": "example.org"})
    own = Listener(server.get_port(), origin=f"http://localhost:{server.get_port()}")
    own.wait(lambda: "/secret" in own.nodes)
    for other in (stranger, renamed):
        other.until_closed()
        assert not other.heard
    own.close()


def test_the_way_by_ssh_names_the_port_at_both_ends(server: viser.ViserServer) -> None:
    port = server.get_port()
    assert by_ssh(server).startswith(f"ssh -N -L {port}:localhost:{port} ")
