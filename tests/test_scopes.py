"""Tests are shared out by scope; a worker that crashes fails its test, and all others still run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from scopes import LAST, scope_of
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
    (tmp_path / "pytest.ini").write_text("[pytest]\n")  # whatever lies in the folders above
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


@pytest.mark.parametrize(
    ("test", "scope"),
    [
        ("tests/exchange/test_rtk.py::test_it", LAST),
        ("tests/recon/test_shifted_panel.py::test_rtk_with_its_filter_agrees", LAST),
        ("tests/xray/test_grey_caster.py::test_caster_agrees_with_rtk", LAST),
        ("tests/cli/test_export.py::test_it[rtk]", "tests/cli/test_export.py"),
        ("tests/study/test_deaths.py::test_it", "pools"),
    ],
)
def test_tests_that_load_rtk_share_a_worker(test, scope):
    assert scope_of(test) == scope


def test_no_other_test_loads_rtk():
    """Each test file that imports ITK has tests that the scope knows."""
    for file in SUPPORT.parent.rglob("test_*.py"):
        text = file.read_text(encoding="utf-8")
        if 'importorskip("itk"' in text and file.name != "test_rtk.py" and file != Path(__file__):
            assert re.search(r"def test_(\w+_)?rtk(_\w+)?\(", text), file
