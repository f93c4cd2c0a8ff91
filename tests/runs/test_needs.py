"""What a run is said to take, against what it takes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from twinct import needs
from twinct.core.errors import MemoryShortageError
from twinct.runs import require_memory
from twinct.scenario import GreyVolume, load_scenario
from twinct.specimen.shapes import shape_surface, triangles

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
FEW = ["trajectory.views=10"]
MEASURE = """
import json, re, sys
from pathlib import Path
from twinct import load_scenario, needs, run
scenario = load_scenario(sys.argv[1], json.loads(sys.argv[3]))
told = max(need.memory_bytes for need in needs(scenario, "local").values())
run(scenario, sys.argv[2], link="local")
peak = re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())
print(json.dumps([told, 1024 * int(peak[1])]))
"""


@pytest.mark.tutorial
@pytest.mark.process
def test_a_run_stays_below_its_needs_and_comes_near_them(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-c", MEASURE, str(DEMO), str(tmp_path / "out"), json.dumps(FEW)],
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    told, taken = json.loads(result.stdout.splitlines()[-1])
    assert taken <= told <= 2 * taken
    scenario = load_scenario(DEMO, FEW)
    folder = sum(f.stat().st_size for f in (tmp_path / "out").rglob("*") if f.is_file())
    disk = sum(need.disk_bytes for need in needs(scenario).values())
    assert folder <= disk <= 4 * folder


def test_each_stage_grows_with_what_it_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWINCT_THREADS", "3")
    small = needs(load_scenario(DEMO), "local")
    assert list(small) == ["specimen", "plan", "views", "truth", "reconstruction", "report"]
    assert small["reconstruction"].threads == 3 and small["plan"].threads == 1
    finer = needs(load_scenario(DEMO, ["reconstruction.grid={voxels: 256, voxel_mm: 0.62}"]))
    for stage in ("truth", "reconstruction", "report"):
        more = finer[stage].memory_bytes + 2500 * 2**20 - small[stage].memory_bytes
        assert more >= 4 * (256**3 - 128**3)
    both = needs(load_scenario(DEMO), "ros2")["views"]
    assert both.processes == 3 and both.memory_bytes > small["views"].memory_bytes


def test_nothing_is_planned_and_a_gantry_takes_no_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twinct.robots.motion.plan_motion", None)
    arms = needs(load_scenario(DEMO, [*FEW, "motion.order=shortest"]))
    gantry = needs(load_scenario(DEMO, [*FEW, "cell={kind: gantry}"]))
    assert gantry["plan"].memory_bytes == gantry["specimen"].memory_bytes
    assert gantry["views"].memory_bytes < arms["views"].memory_bytes


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "reconstruction.grid.voxels=4096",
            "reconstruction.grid: 4096 x 4096 x 4096 voxels: at least 576",
        ),
        ("reconstruction.zoom={size_mm: 1, voxel_mm: 1e-5}", "reconstruction.zoom: 100000 x"),
        (
            "specimen.parts.0.shape.mesh_resolution_mm=0.01",
            "specimen.parts.0.shape: part",
        ),
        ("trajectory.views=100000", "trajectory: 100000 views of 160 x 120 pixels: at least 14.3"),
        (
            "specimen.parts.0.shape={kind: ball_helix, balls: 1000, mesh_resolution_mm: 1e-5}",
            "specimen.parts.0.shape: part 'skull': at least 15.3",
        ),
    ],
)
def test_what_no_memory_holds_is_named_before_anything_is_made(
    monkeypatch: pytest.MonkeyPatch, override: str, said: str
) -> None:
    module = sys.modules["twinct.runs.needs"]  # the package has a function of this name
    monkeypatch.setattr(module, "available_bytes", lambda: (8 * 2**30, "a limit"))
    require_memory(load_scenario(DEMO))
    with pytest.raises(MemoryShortageError) as caught:
        require_memory(load_scenario(DEMO, [override]))
    (problem,) = caught.value.problems
    assert problem.startswith(said)
    assert problem.endswith("are needed, but only 8.00 GiB are available (a limit)")


def test_a_ball_has_the_triangles_that_are_counted() -> None:
    for text in ("{kind: sphere, radius_mm: 2, mesh_resolution_mm: 0.5}", "{kind: ball_helix}"):
        scenario = load_scenario(DEMO, [f"specimen.parts=[{{shape: {text}}}]"])
        shape = scenario.specimen.parts[0].shape
        assert triangles(shape) == len(shape_surface(shape, "x").faces)


def test_a_breathing_patient_has_its_voxels_twice() -> None:
    breathing = load_scenario("patient_breathing")
    still = breathing.with_({"specimen.motion": None, "reconstruction.motion": None})
    shape = breathing.specimen.parts[0].shape
    assert isinstance(shape, GreyVolume)
    voxels = 338 * 238 * 480 / shape.voxel_mm**3
    for stage in ("views", "truth"):
        more = needs(breathing)[stage].memory_bytes - needs(still)[stage].memory_bytes
        assert more == pytest.approx(12 * voxels, rel=0.01)
