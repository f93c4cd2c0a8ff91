"""Workers import what they do by name: the jobs are those of the tests of workers."""

from __future__ import annotations

import os
import sys
from pathlib import Path

JOBS = str(Path(__file__).parents[1] / "workers")

if JOBS not in sys.path:
    sys.path.insert(0, JOBS)

# Ray reads them once in a process.
os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "0123456789abcdef" * 4}

# Of drivers and of the nodes of simulated clusters.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [JOBS, os.environ.get("PYTHONPATH")]))
