"""Time how long twinct takes to start: importing ``run``, the help, and a mistake in a scenario.

    python benchmarks/bench_start.py

Each is started five times in a process of its own, after once to fill the disk's cache; the median
and the slowest are printed.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

DEMO = str(Path(__file__).parents[1] / "scenarios" / "demo.yaml")
TIMES = 5
STARTS = {
    "from twinct import run": ["-c", "from twinct import run"],
    "twinct --help": ["-m", "twinct", "--help"],
    "twinct check, a wrong key": ["-m", "twinct", "check", DEMO, "--set", "detector.colums=3"],
}


def main() -> None:
    """Print the seconds of each start."""
    for name, arguments in STARTS.items():
        seconds = [_seconds(arguments) for _ in range(1 + TIMES)][1:]
        print(f"{name:27} {statistics.median(seconds):5.2f} s, slowest {max(seconds):5.2f} s")


def _seconds(arguments: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], capture_output=True, check=False)
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
