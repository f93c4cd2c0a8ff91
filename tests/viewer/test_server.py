from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
import viser
import websockets.asyncio.server
from listener import Listener
from viser import _messages as messages
from waiting import HANG_S, until
from websockets.exceptions import ConnectionClosed, InvalidStatus

from twinct.core.errors import InputError
from twinct.viewer.guard import LARGEST_MESSAGE, MOST_SAID
from twinct.viewer.server import LOOPBACK, Server, address, by_ssh, close, serve


def bound_to(server: Server) -> list[str]:
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


def test_it_listens_on_loopback_and_shares_nothing(server: Server) -> None:
    assert server.get_host() == LOOPBACK
    assert all(host.startswith("127.") or host == "::1" for host in bound_to(server))
    handlers = server._websock_server._incoming_handlers
    assert messages.ShareUrlRequest not in handlers
    listener = Listener(address(server))
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


def test_a_port_in_use_is_refused(server: Server) -> None:
    with pytest.raises(InputError, match=f"--port {server.get_port()}: the port is in use"):
        serve(LOOPBACK, server.get_port())


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none_is_refused(port: int) -> None:
    with pytest.raises(InputError, match=f"--port {port}: a port is a number"):
        serve(LOOPBACK, port)


def test_the_network_is_opened_only_where_allowed() -> None:
    with pytest.raises(InputError, match="for this machine only.*--allow-network"):
        serve("0.0.0.0", 0)
    with pytest.raises(InputError, match="--host 192.0.2.1"):
        serve("192.0.2.1", 0, allow_network=True)  # of no machine (RFC 5737)


@pytest.fixture(params=[False, True], ids=["loopback", "network"])
def opened(request: pytest.FixtureRequest) -> Iterator[Server]:
    """A page with something to hide."""
    network: bool = request.param
    made = serve("0.0.0.0" if network else LOOPBACK, 0, allow_network=network)
    made.scene.add_frame("/secret")
    yield made
    close(made)


def refused(page: str, **headers: Any) -> bool:
    """Whether a connection is refused before anything is sent."""
    try:
        listener = Listener(page, **headers)
    except InvalidStatus as refusal:
        assert refusal.response.status_code == 403
        assert "secret" not in refusal.response.body.decode()
        return True
    listener.wait(lambda: "/secret" in listener.nodes)
    listener.close()
    return False


def test_who_has_the_address_looks_in(opened: Server) -> None:
    port = opened.get_port()
    assert opened.get_host() == ("0.0.0.0" if opened.guard.any_address else LOOPBACK)
    assert messages.ShareUrlRequest not in opened._websock_server._incoming_handlers
    page = address(opened)
    assert page.startswith(f"http://localhost:{port}/") and len(urlsplit(page).path) > 42
    assert not refused(page)
    assert not refused(page, origin=f"http://localhost:{port}")
    # Through ssh from another port, where the browser knows the page by that.
    near = f"http://localhost:9999/{opened.guard.token}/"
    assert not refused(near, origin="http://localhost:9999", port=port)


WITHOUT = ("", "wrong/", "%2e%2e/")


@pytest.mark.parametrize("path", WITHOUT)
def test_without_the_token_nothing_is_sent(opened: Server, path: str) -> None:
    port = opened.get_port()
    page = f"http://localhost:{port}/{path}"
    assert refused(page)
    assert refused(page, origin=f"http://localhost:{port}")
    assert refused(f"{page}?token={opened.guard.token}")
    for file in ("", "index.html"):
        with pytest.raises(HTTPError, match="403") as found:
            urlopen(f"{page}{file}", timeout=HANG_S)
        found.value.close()


def test_pages_of_others_do_not_look_in_even_with_the_token(opened: Server) -> None:
    port, page = opened.get_port(), address(opened)
    assert refused(page, origin=f"http://localhost:{port + 1}")
    assert refused(page, origin="http://localhost")
    assert refused(page, origin="http://example.org")
    assert refused(page, origin=f"http://example.org:{port}")
    assert refused(page, origin="null")
    # A site has pointed its name to this machine.
    for name in (f"example.org:{port}", "localhost.example.org", "example.org"):
        renamed = f"http://{name}/{opened.guard.token}/"
        assert refused(renamed, port=port)
        assert refused(renamed, origin=f"http://{name}", port=port)


def test_a_page_of_the_network_answers_to_addresses_and_the_machines_name(opened: Server) -> None:
    port, network = opened.get_port(), opened.guard.any_address
    for name in ("192.0.2.1", "[2001:db8::1]", socket.gethostname()):
        origin = f"http://{name}:{port}"
        assert refused(f"{origin}/{opened.guard.token}/", origin=origin) != network


@pytest.mark.parametrize("host", [b"", b"Host: localhost;x\r\n", 2 * b"Host: localhost\r\n"])
def test_a_request_that_no_browser_makes_is_refused(server: Server, host: bytes) -> None:
    path = urlsplit(address(server)).path.encode()
    with socket.create_connection((LOOPBACK, server.get_port()), HANG_S) as asking:
        asking.sendall(b"GET " + path + b" HTTP/1.1\r\n" + host + b"\r\n")
        assert asking.recv(12) == b"HTTP/1.1 403"


def test_the_page_keeps_its_address_to_itself(server: Server) -> None:
    with urlopen(address(server), timeout=HANG_S) as page:
        assert b"<title>Viser</title>" in page.read()
        assert page.headers["Referrer-Policy"] == "no-referrer"
        assert "frame-ancestors 'none'" in page.headers["Content-Security-Policy"]
    other = serve(LOOPBACK, 0)
    close(other)
    assert other.guard.token != server.guard.token
    assert server.guard.token not in repr(server.guard)


def test_refusals_are_logged_but_not_without_end(server: Server, caplog) -> None:
    port = server.get_port()
    for number in range(2 * MOST_SAID):
        for _ in range(2):
            assert refused(address(server), origin=f"http://localhost:{port + 1 + number}")
    assert caplog.text.count("refused a request") == MOST_SAID
    assert f"A page of 'http://localhost:{port + 1}'" in caplog.text
    assert server.guard.token not in caplog.text


def test_messages_are_small(server: Server) -> None:
    after = server.gui.add_checkbox("after", False)
    listener = Listener(address(server))
    listener.wait(lambda: listener.control("after"))
    told = {"type": "GuiUpdateMessage", "updates": {}}
    listener.send({**told, "uuid": "x" * (LARGEST_MESSAGE - 100)})
    listener.set("after", True)
    until(lambda: after.value, "what was sent after a message that is just small enough")
    with suppress(ConnectionClosed):  # it may be closed while this is sent
        listener.send({**told, "uuid": "x" * LARGEST_MESSAGE})
    listener.until_closed()


def test_a_viser_that_asks_nobody_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a change of viser's would leave the page open."""
    real = websockets.asyncio.server.serve

    class Other:
        """As if viser had another way to it."""

        asyncio = SimpleNamespace(server=SimpleNamespace(serve=real))
        datastructures, exceptions = websockets.datastructures, websockets.exceptions

    monkeypatch.setattr(viser.infra._infra, "websockets", Other)
    with pytest.raises(RuntimeError, match="does not let requests be checked"):
        serve(LOOPBACK, 0)


def test_the_way_by_ssh_names_the_port_at_both_ends(server: Server) -> None:
    port = server.get_port()
    assert by_ssh(server).startswith(f"ssh -N -L {port}:localhost:{port} ")
