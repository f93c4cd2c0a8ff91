"""A process that uses a Ray of its own, for tests that kill it: python driver.py FOLDER."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from pool_jobs import hold

from twinct.workers import Work
from twinct.workers.cluster import RayPool

if __name__ == "__main__":
    os.environ["TWINCT_CACHE"] = sys.argv[1]
    with RayPool("local", name="study", workers=2, memory_bytes=2**32) as pool:
        for key in "abc":
            pool.submit(Work(key, hold, None))
        (Path(sys.argv[1]) / "up").write_text("")
        pool.wait()
