"""A small scenario that each test changes as it needs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trimesh
from small_ctsimu import small_scenario


@pytest.fixture
def data() -> dict[str, Any]:
    return small_scenario()


@pytest.fixture
def write(tmp_path: Path) -> Callable[[dict[str, Any]], Path]:
    """Write a scenario beside its cube."""

    def put(data: dict[str, Any]) -> Path:
        trimesh.creation.box((10, 10, 10)).export(tmp_path / "cube.stl")
        path = tmp_path / "small.json"
        path.write_text(json.dumps(data))
        return path

    return put
