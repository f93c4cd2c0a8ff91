"""``twinct doctor`` says what works here, and the command that brings the rest."""

from __future__ import annotations

import json
import subprocess
import sys
from unittest.mock import Mock

import pytest

from twinct.cli import parts, run_command
from twinct.core.installation import install_command


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Lines of a machine without mink and ROS, whose OpenGL is broken, by part."""
    for module in ("mink", "rclpy"):
        monkeypatch.setitem(sys.modules, module, None)
    broken = "gVXR cannot be loaded: libEGL.so.1 is missing: apt-get install libegl1"
    tried = Mock(return_value=subprocess.CompletedProcess([], 1, "", f"{broken}\n"))
    monkeypatch.setattr(parts.subprocess, "run", tried)
    assert run_command(["doctor"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert len(said) == len(parts.PARTS), "each part has one line, so that it can be copied"
    return {part.name: line for part, line in zip(parts.PARTS, said, strict=True)}


def test_a_missing_package_comes_with_its_command(lines: dict[str, str]) -> None:
    assert "does not work: mink is not installed" in lines["arms"]
    assert install_command(["robots"]) in lines["arms"]
    assert install_command(["ros"]) in lines["link ros2"]


def test_a_library_that_fails_gives_its_own_reason(lines: dict[str, str]) -> None:
    assert "apt-get install libegl1" in lines["engine gvxr"]


def test_what_needs_nothing_works(lines: dict[str, str]) -> None:
    assert "works: projections with rays of our own" in lines["engine mesh"]
    assert "works: both simulations in one process" in lines["link local"]


@pytest.mark.process
def test_the_picture_of_the_room_is_tried_and_scripts_get_an_object(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = [part for part in parts.PARTS if part.name == "picture of the room"]
    monkeypatch.setattr("twinct.cli.commands.doctor.PARTS", drawn)
    assert run_command(["doctor", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["parts"]
    assert one["works"] and one["problems"] == []
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert run_command(["doctor", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["parts"]
    assert not one["works"] and "switches pictures of the room off" in one["problems"][0]
