"""What a run is said to take, against what it takes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from twinct import needs
from twinct.scenario import load_scenario

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
    monkeypatch.setattr("twinct.motion.plan_motion", None)
    arms = needs(load_scenario(DEMO, [*FEW, "motion.order=shortest"]))
    gantry = needs(load_scenario(DEMO, [*FEW, "cell={kind: gantry}"]))
    assert gantry["plan"].memory_bytes == gantry["specimen"].memory_bytes
    assert gantry["views"].memory_bytes < arms["views"].memory_bytes
