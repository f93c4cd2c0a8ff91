"""What docs/stability.md calls public is there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

from twinct.runs import Folder

PAGE = (Path(__file__).parents[1] / "docs" / "stability.md").read_text(encoding="utf-8")
IMPORTS = next(line for line in PAGE.splitlines() if line.startswith("| imports |"))


def test_public_packages_list_names_that_exist() -> None:
    packages = re.findall(r"`(twinct[a-z_.]*)`", IMPORTS.partition("; errors")[0])
    assert len(packages) > 10
    for package in packages:
        module = importlib.import_module(package)
        assert module.__all__, package
        for name in module.__all__:
            assert hasattr(module, name), f"{package}.{name}"


def test_public_folders_are_named_as_a_run_names_them() -> None:
    folder = Folder(Path("x"))
    members = (getattr(folder, name, None) for name in dir(folder) if not name.startswith("_"))
    have = {member.name for member in members if isinstance(member, Path)}
    line = next(line for line in PAGE.splitlines() if line.startswith("| folders |"))
    named = {name.rstrip("/") for name in re.findall(r"`([^`]+)`", line)}
    assert named and named <= have
