"""Fuzz twinct: thousands of broken inputs, each of which must give a correct result or a message.

    python tools/fuzz scenarios --minutes 10 --seed 1
    python tools/fuzz files bodies --count 2000 --seed 2
    python tools/fuzz scenarios --seed 1 --only 4711

Kind, seed and number identify a case. A case fails if it ends with anything but a result or an
``InputError``, or uses too much processor time or memory; its files are stored below --out. The
exit code is 1 if any case failed.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from pathlib import Path

from driver import fuzz

KINDS = {
    **{"scenarios": "scenario_files", "bodies": "bodies", "files": "input_files"},
    **{"imports": "imports", "stores": "store_files"},
}
"""Name of the module of each kind, which has a class ``Kind``."""


def main() -> int:
    """Parse the arguments, try the cases and print a summary of each kind."""
    parser = argparse.ArgumentParser(
        prog="tools/fuzz", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    names = f"{', '.join(KINDS)}, or all"
    parser.add_argument("kinds", nargs="+", choices=(*KINDS, "all"), metavar="KIND", help=names)
    parser.add_argument(
        "--minutes", type=float, help="minutes per kind (default: 1, or by --count)"
    )
    parser.add_argument("--count", type=int, help="largest number of cases per kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="number of the only case to try")
    parser.add_argument("--any-speed", action="store_true", help="accept slow cases")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    arguments = parser.parse_args()
    minutes = arguments.minutes or (1 if arguments.count is None else math.inf)
    failed = False
    for kind in KINDS if "all" in arguments.kinds else arguments.kinds:
        every = itertools.islice(itertools.count(), arguments.count)
        chosen = every if arguments.only is None else [arguments.only]
        before = time.monotonic()
        place = arguments.out.absolute() / kind
        speed = {"any_speed": arguments.any_speed}
        found = fuzz(KINDS[kind], arguments.seed, chosen, 60 * minutes, place, **speed)
        words = ", ".join(f"{number} {word}" for word, number in found.words.most_common())
        sys.stdout.write(
            f"{kind}, seed {arguments.seed}: {found.words.total()} cases in "
            f"{time.monotonic() - before:.0f} s: {words}; slowest {found.slowest[0]:.2f} s "
            f"(case {found.slowest[1]}), most memory {found.largest[0] / 2**20:.0f} MB "
            f"(case {found.largest[1]}); {len(found.failures)} failures\n"
        )
        if arguments.only is not None:
            sys.stdout.write(f"files of the case: {place / 'case'}\n")
        failed = failed or bool(found.failures)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
