from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from twinct import run
from twinct.runs import Run
from twinct.scenario import Scenario, load_scenario

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"


@pytest.fixture(scope="session")
def tiny_keys() -> list[str]:
    """What makes a scenario of seconds of the demo."""
    return [
        "trajectory.views=10",
        "xray.engine=mesh",
        "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
        "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
        "reconstruction.grid={voxels: 20, voxel_mm: 8}",
        "reconstruction.iterations=2",
    ]


@pytest.fixture(scope="session")
def tiny(tiny_keys: list[str]) -> Callable[..., Scenario]:
    """That scenario, with more keys."""
    return lambda *more: load_scenario(DEMO, [*tiny_keys, *more])


@pytest.fixture(scope="session")
def finished(tiny: Callable[..., Scenario], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of it; its folder must stay as it is."""
    return run(tiny(), tmp_path_factory.mktemp("run") / "out", link="local")


@contextmanager
def no_report() -> Iterator[None]:
    """Leave the report of a run empty, as it takes longest to draw; the figures are there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twinct.runs.reporting.draw_pictures", lambda _: {})
        patch.setattr("twinct.runs.reporting.write_report", lambda path, *_: path.touch())
        yield


@pytest.fixture
def unreported() -> Iterator[None]:
    """Leave the reports of a test's runs out."""
    with no_report():
        yield
