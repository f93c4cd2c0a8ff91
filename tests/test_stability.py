"""What docs/stability.md calls public is there."""

from __future__ import annotations

import re
from pathlib import Path

import twinct
from twinct.runs import Folder

PAGE = (Path(__file__).parents[1] / "docs" / "stability.md").read_text(encoding="utf-8")


def test_public_names_exist() -> None:
    assert twinct.__all__
    assert all(hasattr(twinct, name) for name in twinct.__all__)


def test_public_folders_are_named_as_a_run_names_them() -> None:
    folder = Folder(Path("x"))
    members = (getattr(folder, name, None) for name in dir(folder) if not name.startswith("_"))
    have = {member.name for member in members if isinstance(member, Path)}
    line = next(line for line in PAGE.splitlines() if line.startswith("| files of a run |"))
    named = {name.rstrip("/") for name in re.findall(r"`([^`]+)`", line)}
    assert named and named <= have
