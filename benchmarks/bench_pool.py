"""What a pool costs: pieces of work that do nothing, in seconds, and bytes that stay in its driver.

python benchmarks/bench_pool.py --works 10000
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

from twinct.workers import Done, LocalPool, Work
from twinct.workers.cluster import RayPool


def resident_bytes():
    """Of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def work(key):
    """A call that does nothing."""
    from bench_pool import nothing  # by a name that a worker can import

    return Work(str(key), nothing, None)


def nothing(argument, place):
    """What is asked for."""


def measure(pool, number):
    """Works a second, and the growth of this process in bytes a work, workers warm."""
    warm = [pool.results(map(work, range(-n, 0))) for n in (8, number // 10)]
    assert all(isinstance(event, Done) for events in warm for event in events)
    before, begun = resident_bytes(), time.perf_counter()
    assert all(isinstance(event, Done) for event in pool.results(map(work, range(number))))
    seconds = time.perf_counter() - begun
    return number / seconds, (resident_bytes() - before) / number


def main():
    """Print a row for each pool."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--works", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    print("pool    works a second  ms a work  bytes of the driver a work")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TWINCT_CACHE"] = folder
        for name, start in (
            ("local", lambda: LocalPool(Path(folder), workers=options.workers)),
            ("Ray", lambda: RayPool("local", name="bench", workers=options.workers)),
        ):
            with start() as pool:
                speed, growth = measure(pool, options.works)
            print(f"{name:6}  {speed:14.0f}  {1000 / speed:9.2f}  {growth:26.0f}", flush=True)


if __name__ == "__main__":
    main()
