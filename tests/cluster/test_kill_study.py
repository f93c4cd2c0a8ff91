"""Death of a worker, of a node and of the driver changes nothing in a study but its seconds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import HANG_S

# The tool has a goal for how soon processes are gone; here only whether they are.
TOOL = f"""
import functools, sys
sys.path.insert(0, {str(Path(__file__).parents[2] / "tools")!r})
import kill_study
kill_study.until_none = functools.partial(kill_study.until_none, patience_s={HANG_S})
sys.exit(kill_study.main())
"""


@pytest.mark.cluster
@pytest.mark.process
def test_one_of_each() -> None:
    """The tool says what it found, and ends with 1 if that is not what is asked for."""
    counts = [f"--{victim}=1" for victim in ("workers", "nodes", "drivers")]
    words = [sys.executable, "-c", TOOL, *counts, "--seeds=2"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "killed: worker 1 of 1, node 1 of 1, driver 1 of 1" in done.stdout
