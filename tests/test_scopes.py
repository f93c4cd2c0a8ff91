"""A worker of the tests that crashes fails its test, and all other tests still run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import HANG_S

SUPPORT = Path(__file__).parent / "support"
FILES = 24
CONFTEST = """
from crashes import CrashReport
from scopes import Scopes

def pytest_configure(config):
    config.pluginmanager.register(CrashReport())

def pytest_xdist_make_scheduler(config, log):
    return Scopes(config, log)
"""
CRASH = """
import os

def test_before(): pass

def test_crash(): os.abort()

def test_after(): pass
"""


@pytest.mark.process
@pytest.mark.tutorial
def test_a_crash_costs_one_test(tmp_path):
    (tmp_path / "conftest.py").write_text(CONFTEST)
    for number in range(FILES):
        text = CRASH if number == FILES // 2 else "def test_it(): pass"
        (tmp_path / f"test_{number:02}.py").write_text(text)
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile"]
        + ["-p", "no:cacheprovider"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(SUPPORT)},
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )
    assert f"1 failed, {FILES + 1} passed" in result.stdout, result.stdout
    assert "Fatal Python error: Aborted" in result.stdout
    assert "in test_crash" in result.stdout
    assert f"crashed while running 'test_{FILES // 2}.py::test_crash'" in result.stdout
