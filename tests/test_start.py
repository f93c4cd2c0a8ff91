"""Starting twinct loads no engine and no plotting: those come where they are used."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = {
    "gvxrPython3",
    "matplotlib",
    "mujoco",
    "networkx",
    "numba",
    "scipy.spatial",
    "trimesh",
    "zarr",
}
LOADED = """
import atexit, json, runpy, sys
atexit.register(lambda: sys.stderr.write(json.dumps(sorted(sys.modules))))
"""
RUN = "from twinct import run"
COMMAND = """
sys.argv = ["twinct", *{arguments}]
runpy.run_module("twinct", run_name="__main__")
"""


def loaded(code: str) -> tuple[list[str], int, str]:
    """Modules of a fresh process at its end, its exit code, and what it said."""
    result = subprocess.run([sys.executable, "-c", LOADED + code], capture_output=True, text=True)
    *said, modules = result.stderr.splitlines()
    return json.loads(modules), result.returncode, "\n".join([result.stdout, *said])


def heavy(modules: list[str]) -> list[str]:
    return sorted(HEAVY.intersection(modules))


@pytest.mark.process
def test_importing_run_loads_nothing_heavy() -> None:
    modules, code, _ = loaded(RUN)
    assert code == 0
    assert "twinct.runs.job" in modules
    assert heavy(modules) == []


@pytest.mark.process
def test_importing_run_looks_for_no_engines_of_other_packages() -> None:
    looked = "from twinct.xray.engines import engines\nassert not engines.cache_info().currsize"
    _, code, said = loaded(f"{RUN}\n{looked}")
    assert code == 0, said


@pytest.mark.process
def test_the_help_loads_nothing_heavy() -> None:
    modules, code, said = loaded(COMMAND.format(arguments=["--help"]))
    assert code == 0
    assert "reconstruct" in said
    assert "twinct.xray.engines" not in modules
    assert heavy(modules) == []


@pytest.mark.process
def test_a_mistake_in_a_scenario_is_told_without_anything_heavy(tmp_path) -> None:
    scenario = tmp_path / "wrong.yaml"
    scenario.write_text("nmae: x\n", encoding="utf-8")
    modules, code, said = loaded(COMMAND.format(arguments=["check", str(scenario)]))
    assert code == 2
    assert "did you mean 'name'?" in said
    assert heavy(modules) == []
