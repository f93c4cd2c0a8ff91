"""Seconds until a hostile scenario file is refused.

    python benchmarks/bench_refusals.py

Exit code 1 where one takes longer than ``--most`` seconds of the processor (2 on a quiet machine).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from twinct.core.errors import ScenarioError
from twinct.core.files.plain_yaml import LARGEST_BYTES, MOST_VALUES, read_file

HOSTILE = {
    "nested lists": "[" * 100_000,
    "too many values": f"a: [{'1,' * MOST_VALUES}]",
    "too large": "#" * (LARGEST_BYTES + 1),
    "a long line": "a: " + "x " * (LARGEST_BYTES // 2 - 10) + "\n: b",
    "a long number": "a: " + "9" * (LARGEST_BYTES - 10),
    "many keys, one twice": "".join(f"k{n}: 1\n" for n in range(50_000)) + "k0: 1\n",
    "many quotes": "a: " + "'" * (LARGEST_BYTES - 10),
    "billion laughs": "a: &a [x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a,*a]\n",
}


def main() -> int:
    """Time each refusal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=float, default=2.0, help="largest processor time in seconds")
    most, slow = parser.parse_args().most, False
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.yaml"
        for name, text in HOSTILE.items():
            path.write_text(text)
            before = time.process_time()
            try:
                read_file(path, "scenario")
                said = "read"
            except ScenarioError:
                said = "refused"
            seconds = time.process_time() - before
            slow = slow or seconds > most
            print(f"{name:22s} {said:8s} {seconds:6.2f} s")
    return 1 if slow else 0


if __name__ == "__main__":
    sys.exit(main())
