"""The page of error messages quotes what the commands say."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from twinct.cli import run_command

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "howto" / "errors.md").read_text(encoding="utf-8")
QUOTED = re.findall(r"^\| `([^`]+)` \|", PAGE, re.MULTILINE)
FAR = "--no-cures --set trajectory.longitude_range_deg=300"
COMMANDS = {
    "detector.colums: unknown key": "check demo --set detector.colums=320",
    "detector.columns: must be a whole": "check demo --set detector.columns=big",
    "scenarios/demo.yml": "check scenarios/demo.yml",
    "specimen.parts.0.shape.path": "check demo --set "
    '"specimen.parts=[{shape: {kind: mesh, path: part.stl}, material: bone}]"',
    "unknown material": "check demo --set specimen.parts.0.material=plastic",
    "needs a photon number": 'check demo --set "detector.noise={kind: quantum}"',
    "of memory are needed": "check circle_gantry --set "
    '"reconstruction.grid={voxels: 4096, voxel_mm: 0.1}"',
    "no view sees": 'check circle_gantry --set "specimen.position_mm=[0, 0, 400]"',
    "detector arm: out of reach": f"check demo {FAR}",
}
"""A command for each message that a wrong scenario gives, by its first words."""


@pytest.mark.parametrize(("words", "command"), COMMANDS.items(), ids=COMMANDS)
def test_a_command_says_what_the_page_quotes(
    words: str,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (message,) = (one for one in QUOTED if one.startswith(words))
    monkeypatch.chdir(ROOT)
    assert run_command(shlex.split(command)) == 2
    assert message in capfd.readouterr().err
