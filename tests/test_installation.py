"""The command that adds an extra takes twinct from where it is: a folder, a wheel or an index."""

from __future__ import annotations

import importlib.metadata
import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from twinct.core.errors import MissingExtraError
from twinct.core.installation import PLACE_LOST, install_command


def noted(monkeypatch: pytest.MonkeyPatch, note: object) -> None:
    """Let pip's note about the installation be another."""
    text = None if note is None else json.dumps(note)
    there = SimpleNamespace(read_text=lambda _: text)
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _: there)


@pytest.mark.parametrize("editable", [False, True])
def test_a_folder_or_wheel_is_named_by_its_path(monkeypatch, tmp_path: Path, editable) -> None:
    place = tmp_path / "my clone"
    place.mkdir()
    noted(monkeypatch, {"url": place.as_uri(), "dir_info": {"editable": editable}})
    flag = "-e " if editable else ""
    command = f"python -m pip install {flag}'{place}[robots,xray]'"
    assert install_command(["robots", "xray"]) == command
    assert command in str(MissingExtraError(["mujoco", "gvxr"], ["robots", "xray"]))


def test_a_place_that_is_gone_is_named_in_words(monkeypatch, tmp_path: Path) -> None:
    noted(monkeypatch, {"url": (tmp_path / "twinct-1.0.0-py3-none-any.whl").as_uri()})
    assert install_command(["ros"]) == f"python -m pip install '{PLACE_LOST}[ros]'"


@pytest.mark.parametrize("note", [None, [], {"url": 7}])
def test_an_index_is_offered_only_if_twinct_came_from_one(monkeypatch, note) -> None:
    noted(monkeypatch, note)
    assert install_command(["ros"], "--force-reinstall") == (
        "python -m pip install --force-reinstall 'twinct[ros]'"
    )
