"""Seconds and memory until small files that unpack to far more than the memory are refused.

python benchmarks/bench_small_files.py

A process for each file of `tests/support/bombs.py`. Seconds are those of its processor from the
call of the reader to the refusal, after all imports; the memory is the largest of the whole
process, imports included, without that of making the file.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
sys.path.insert(0, str(SUPPORT))

import bombs  # noqa: E402
import read_bombs  # noqa: E402


def timed(name, folder):
    """Refusal, memory and size as `read_bombs.tried`, and the seconds of the reader."""
    seconds = []
    made = read_bombs.reader

    def reader(name):
        read = made(name)

        def watched(path, out):
            before = time.process_time()
            try:
                return read(path, out)
            finally:
                seconds.append(time.process_time() - before)

        return watched

    read_bombs.reader = reader
    return (*read_bombs.tried(name, folder), seconds[0])


def main():
    """One line for each file."""
    if len(sys.argv) > 1:
        print(json.dumps(timed(sys.argv[1], Path(sys.argv[2]))))
        return
    print(f"{'file':<16}{'bytes':>10}{'seconds':>9}{'MB':>6}  refusal")
    for make in (*bombs.IMPORTED, *bombs.BODIES, *bombs.ARMS):
        with tempfile.TemporaryDirectory() as folder:
            line = [sys.executable, __file__, make.__name__, str(Path(folder) / "case")]
            done = subprocess.run(line, capture_output=True, text=True, check=True)
            refusal, peak, size, seconds = json.loads(done.stdout.splitlines()[-1])
            words = refusal.replace(folder, "")[:90]
            print(f"{make.__name__:<16}{size:>10}{seconds:>9.2f}{peak / 1e6:>6.0f}  {words}")


if __name__ == "__main__":
    main()
