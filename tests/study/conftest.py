"""A scenario that takes a small part of a second, and studies of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from twinct.workers import LocalPool
from twinct.workers.artifact import remove

SCENARIO: dict[str, Any] = {
    "cell": {"kind": "gantry"},
    "xray": {"engine": "mesh"},
    "trajectory": {"kind": "circle", "views": 4},
    "detector": {"columns": 24, "rows": 18, "pixel_pitch_mm": 13},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 4}}]
    },
    "reconstruction": {
        "algorithm": "sart",
        "iterations": 1,
        "grid": {"voxels": 16, "voxel_mm": 10},
    },
}


@pytest.fixture(scope="module", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What trials take here is no business of the user's own book, nor the other way round."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("TWINCT_THREADS", "1")
        yield


class WarmPool(LocalPool):
    """Its worker outlives a study: to start another one takes seconds."""

    def close(self, *, clear: bool = False) -> None:
        """Leave the worker and, if asked, nothing else."""
        while self.wait():
            pass
        for path in self.folder.iterdir() if clear else ():
            if path.name != "logs":
                remove(path)

    def end(self) -> None:
        """What ``LocalPool.close`` does."""
        super().close()


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WarmPool]:
    """The pool of all studies of a test file, with one worker."""
    pool = WarmPool(tmp_path_factory.mktemp("node"), workers=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twinct.study.running._pool", lambda *_: pool)
        yield pool
    pool.end()


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
