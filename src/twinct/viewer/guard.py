"""Check of each request to the page: its token, and the site that its sender shows.

A browser lets any page open a websocket to any address, also to this machine, and any user of this
machine reaches loopback. The token in the page's address keeps both out. It is part of the path,
because viser's client drops a query, and because browsers send a cookie to all ports of a host.

``Host`` and ``Origin`` (RFC 6455, section 10.2) are a second check: they reveal pages of other
ports and hosts, and names that a site has pointed to this machine.
"""

from __future__ import annotations

import http
import ipaddress
import logging
import re
import secrets
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

log = logging.getLogger(__name__)

LARGEST_MESSAGE = 2**16
"""Largest message from a browser, bytes; cameras and controls need less than a hundredth."""

LARGEST_PART = 2**19
"""Bytes of a file in one message, as viser's client sends it to a page that accepts files."""

MOST_SAID = 10
"""Number of different refusals that are logged; more say nothing new."""

LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})

_HOST = re.compile(r"(?:\[(?P<v6>[0-9a-f:.]+)\]|(?P<name>[a-z0-9._-]+))(?::[0-9]{1,5})?")

_Serve = Callable[[ServerConnection, Request], Response | None]


@dataclass(frozen=True)
class Guard:
    """Check of the requests to one server.

    Attributes:
        names: names and addresses, in lower case, by which browsers may call it.
        any_address: also accept every IP address, which no site can point elsewhere.
        token: secret first segment of each path; random, 256 bits.
    """

    names: Collection[str] = LOCAL_NAMES
    any_address: bool = False
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)
    _said: set[str] = field(default_factory=set[str], init=False, repr=False)

    def over(self, serve: _Serve) -> _Serve:
        """Return ``serve`` for the requests that pass; it sees their paths without the token."""

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            refusal = self._refusal(request.headers) or self._taken(request)
            if refusal:
                self._say(refusal)
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refusal}\n")
            response = serve(connection, request)
            if response is not None:
                response.headers.update(_protection(request.headers["Host"]))
            return response

        return guarded

    def _refusal(self, headers: Headers) -> str:
        """Return why a request comes from another site; empty if it does not."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        host = hosts[0].lower() if len(hosts) == 1 else ""
        match = _HOST.fullmatch(host)
        if match is None or not self._is_own(match["v6"] or match["name"]):
            return (
                f"The page does not answer to the name {host[:80]!r}: use the printed address, or "
                "this machine's IP address."
            )
        own = (f"http://{host}", f"https://{host}")
        if any(origin.lower() not in own for origin in origins):
            return f"A page of {origins[0][:80]!r} asked for this page of {host!r}."
        return ""

    def _is_own(self, name: str) -> bool:
        return name in self.names or (self.any_address and _is_address(name))

    def _taken(self, request: Request) -> str:
        """Take the token out of a path; return why it is refused, or nothing."""
        token, _, rest = request.path.removeprefix("/").partition("/")
        token, mark, query = token.partition("?")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            return "This address lacks the page's token: use the address that twinct printed."
        request.path = f"/{rest}{mark}{query}"
        return ""

    def _say(self, text: str) -> None:
        if text not in self._said and len(self._said) < MOST_SAID:
            self._said.add(text)
            log.warning("refused a request: %s", text)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _protection(host: str) -> dict[str, str]:
    """Return headers that keep the token here, and the page out of other pages.

    The client is one file of inline scripts, which make workers and WebAssembly from memory.
    """
    own = f"'self' ws://{host} wss://{host} data: blob:"
    return {
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-store",
        "X-Content-Type-Options": "nosniff",
        "Content-Security-Policy": (
            f"default-src {own} 'unsafe-inline' 'unsafe-eval'; "
            "frame-ancestors 'none'; form-action 'none'; base-uri 'none'; object-src 'none'"
        ),
    }
