"""One list of system libraries: in the package, the tool, the README and the pages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.core.errors import DrawingError
from twinct.core.system_libraries import ALL, apt_line
from twinct.robots.cell import check_drawing, render
from twinct.runs import run
from twinct.scenario import load_scenario

ROOT = Path(__file__).parents[1]
LINE = apt_line(("python3-venv", *ALL))


@pytest.mark.parametrize("page", ["README.md", "docs/packages.md"])
def test_the_pages_state_the_line_of_apt(page: str) -> None:
    assert LINE in (ROOT / page).read_text(encoding="utf-8").splitlines()


def test_the_tool_installs_the_same() -> None:
    script = (ROOT / "tools" / "system-libraries").read_text(encoding="utf-8")
    packages = re.search(r"packages=\(\n(.*?)\n\)", script, re.DOTALL)
    assert packages is not None and packages[1].split() == [*ALL]


def test_the_readme_states_the_lines_in_the_order_in_which_they_are_typed() -> None:
    told = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Try it")[2]
    lines = [LINE, "python3 -m venv venv", "source venv/bin/activate", "pip install", "twinct demo"]
    places = [told.find(line) for line in lines]
    assert -1 not in places and places == sorted(places)


@pytest.mark.process
def test_a_bare_machine_gets_the_lines_of_the_readme_and_no_others() -> None:
    def shown(*arguments: str) -> list[str]:
        command = [str(ROOT / "tools" / "bare-machine"), "--show", *arguments]
        return subprocess.run(command, capture_output=True, text=True).stdout.splitlines()

    readme = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    told = shown()
    assert told[0] == "apt-get update" and told[1] == LINE and told[-1] == "twinct demo"
    assert all(line in readme for line in told)
    tool = (ROOT / "tools" / "bare-machine").read_text()
    assert 'debootstrap --variant=minbase --components="$components" "$system" "$root"' in tool
    assert shown("--system", "trixie") == shown("--system", "noble") == told
    assert shown("--system", "sid") == []
    bare = shown("--without", "lib", "--extras", "")
    assert bare[1] == apt_line(["python3-venv"]) and 'pip install "."' in bare


@pytest.mark.process
@pytest.mark.parametrize("chosen", [None, "egl"])
def test_without_egl_mujoco_is_imported_and_told_not_to_draw(chosen: str | None) -> None:
    """MuJoCo 4 ends its own import in an AttributeError if it is to draw with EGL."""
    script = (
        "import ctypes, os; load = ctypes.CDLL\n"
        "def none(name, *rest, **more):\n"
        "    if 'EGL' in str(name): raise OSError(name)\n"
        "    return load(name, *rest, **more)\n"
        "ctypes.CDLL = none\n"
        "import twinct, mujoco; print(os.environ['MUJOCO_GL'], mujoco.MjModel.__name__)\n"
        "from twinct.robots.cell import check_drawing; check_drawing()"
    )
    own = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    own |= {} if chosen is None else {"MUJOCO_GL": chosen}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=own)
    assert done.stdout == "disable MjModel\n", done.stderr
    assert "DrawingError" in done.stderr and "apt-get install" in done.stderr
    assert "libegl1" in done.stderr.splitlines()[-1]


def test_without_egl_a_run_lacks_only_the_picture_and_says_so_once_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    monkeypatch.setattr(render, "egl_is_there", lambda: False)
    scenario = load_scenario(
        ROOT / "scenarios" / "circle_gantry.yaml",
        [
            *("trajectory.views=4", "detector={columns: 16, rows: 12, pixel_pitch_mm: 20}"),
            "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
            *("reconstruction.grid={voxels: 10, voxel_mm: 16}", "reconstruction.iterations=1"),
            "xray.engine=mesh",
        ],
    )
    told: list[str] = []

    def observe(event: object) -> None:
        told.append(str(event))

    made = run(scenario, tmp_path / "out", link="local", observers=[observe])
    about = [number for number, text in enumerate(told) if "picture of the room" in text]
    assert len(about) == 1 and "apt-get install" in told[about[0]], told
    first_stage = next(number for number, text in enumerate(told) if "StageBegan" in text)
    assert about[0] < first_stage
    assert "operating room" not in made.paths.report.read_text(encoding="utf-8")
    with pytest.raises(DrawingError, match="libEGL.so.1 to draw the room: apt-get install"):
        check_drawing()
