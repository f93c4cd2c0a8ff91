"""The folder of a node's work, in a folder for temporary files that all users share."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from twinct.core.errors import InputError
from twinct.workers.cluster.node import folder


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where it will be; not there yet."""
    monkeypatch.delenv("TWINCT_CACHE", raising=False)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    return tmp_path / f"twinct-studies-{os.getuid()}"


def test_nobody_else_may_look_into_it(own: Path) -> None:
    for _ in range(2):
        assert folder("study").parent == own / "study"
        assert own.stat().st_mode & 0o777 == 0o700


def open_to_all(own: Path) -> None:
    own.mkdir()
    own.chmod(0o777)


def link(own: Path) -> None:
    elsewhere = own.with_name("elsewhere")
    elsewhere.mkdir()
    own.symlink_to(elsewhere)


@pytest.mark.parametrize("plant", [open_to_all, link, Path.touch])
def test_what_others_have_put_there_is_refused(own: Path, plant: Callable[[Path], None]) -> None:
    plant(own)
    with pytest.raises(InputError, match="another user may write there.*TWINCT_CACHE"):
        folder("study")


def test_that_of_another_user_is_refused(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own.mkdir(0o700)
    uid = os.getuid()
    asked = iter([uid, uid + 1])  # for its name, then for its owner
    monkeypatch.setattr(os, "getuid", lambda: next(asked))
    with pytest.raises(InputError, match="another user"):
        folder("study")


def test_a_folder_that_the_user_names_is_taken(own: Path, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TWINCT_CACHE", str(tmp_path / "mine"))
    assert folder("study").parent == tmp_path / "mine" / "study"
    assert not own.exists()
