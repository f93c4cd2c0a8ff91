"""Fixtures of tests that open a page: a server, and no waiting for browsers that may come."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from twinct.viewer import live_page
from twinct.viewer.server import LOOPBACK, Server, close, serve


@pytest.fixture
def files() -> bool:
    """Whether the server permits files; the tests of a page that does override it."""
    return False


@pytest.fixture
def server(files: bool) -> Iterator[Server]:
    """On any port."""
    made = serve(LOOPBACK, 0, files=files)
    yield made
    close(made)


@pytest.fixture(autouse=True)
def no_browser_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_page, "BROWSER_COMES_S", 0.0)
    monkeypatch.setattr(live_page, "BROWSER_DRAWS_S", 0.0)
