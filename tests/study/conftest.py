"""A scenario that takes a small part of a second, and studies of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

SCENARIO: dict[str, Any] = {
    "cell": {"kind": "gantry"},
    "trajectory": {"kind": "circle", "views": 4},
    "detector": {"columns": 24, "rows": 18, "pixel_pitch_mm": 13},
    "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 50}}]},
    "reconstruction": {
        "algorithm": "sart",
        "iterations": 1,
        "grid": {"voxels": 16, "voxel_mm": 10},
    },
}


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """What trials take here is no business of the user's own book, nor the other way round."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.setenv("TWINCT_THREADS", "1")


@pytest.fixture
def small() -> Callable[..., dict[str, Any]]:
    """A maker of plain studies of that scenario."""
    return lambda **keys: {"scenario": SCENARIO, **keys}


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Path]:
    """A maker of study files: the scenario takes the first line, the text comes after it."""

    def write(text: str) -> Path:
        path = tmp_path / "study.yaml"
        scenario = yaml.safe_dump(SCENARIO, default_flow_style=True, width=10_000).strip()
        path.write_text(f"scenario: {scenario}\n{text}")
        return path

    return write
