from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from pages import files, no_browser_is_waited_for, server
from waiting import HANG_S

from twinct import run
from twinct.runs import Run
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario
from twinct.viewer.filling import fill
from twinct.viewer.live_page import Page
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.show import Show

__all__ = ["files", "no_browser_is_waited_for", "server"]

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"

KEYS = (
    "trajectory.views=8",
    "detector={columns: 48, rows: 32, pixel_pitch_mm: 6}",
    # Nothing about it is the same from two sides.
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 35, mesh_resolution_mm: 4}}, "
    "{name: bump, shape: {kind: sphere, radius_mm: 22, mesh_resolution_mm: 4}, "
    "position_mm: [40, 30, 35]}]",
    "reconstruction.grid={voxels: [20, 24, 28], voxel_mm: 6}",
    "reconstruction.iterations=2",
)


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    """Of seconds."""
    return load_scenario(DEMO, KEYS)


@pytest.fixture(scope="session")
def finished(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of it; its folder must stay as it is."""
    return run(scenario, tmp_path_factory.mktemp("view") / "out", link="local")


@pytest.fixture(scope="session")
def builder(finished: Run) -> SimulationBuilder:
    """The run's, which builds its parts once."""
    show = RunFolder(finished.paths.path).look()
    return SimulationBuilder(show.scenario, show.plan)


@pytest.fixture
def put(builder: SimulationBuilder) -> Callable[[Page, int, Show], None]:
    """Puts the run on a page; returns when all of it is painted."""

    def wait(page: Page, run: int, show: Show) -> None:
        filling = fill(page, run, show, builder)
        filling.join(HANG_S)
        assert not filling.is_alive()
        assert page.settle(HANG_S)

    return wait
