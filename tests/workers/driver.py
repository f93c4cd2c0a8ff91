"""A process that uses a pool, for tests that kill it: python driver.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

from pool_jobs import hold

from twinct.workers import LocalPool, Work

if __name__ == "__main__":
    with LocalPool(Path(sys.argv[1]), workers=2) as pool:
        for key in "abc":
            pool.submit(Work(key, hold, None))
        pool.wait()
