"""Let faults meet commands of twinct while they work, and see what the commands leave behind.

    python tools/trials --trials 400 --seed 1
    python tools/trials --trials 20 --commands run study --faults SIGKILL Ctrl-C
    python tools/trials --seed 1 --only 17

Each trial runs a command on a tiny scenario until a fault meets it at a drawn moment (a signal to
the command or to a process of it, a disk that fills up, a clock that jumps), or under a condition
that holds all along (few descriptors, little memory, no HOME, ...). The command must end with the
right exit code and message, without a traceback; no result may be damaged, no process, shared
memory or draft may be left. Then the command is continued with --resume, or repeated: it must make
nothing again that is there already, and end with the bytes of an undisturbed command. The exit code
is 1 otherwise, and the words that repeat a failed trial are printed. Conditions that need the right
to mount disks are skipped without it, and so is the look into /dev/shm. A study on a cluster, by
Ray, is tried only if it is named.
"""

import argparse
import random
import shlex
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from contextlib import ExitStack
from pathlib import Path

from commands import COMMANDS
from faults import FAULTS, suits
from trial import Trials

LOCAL = [name for name, command in COMMANDS.items() if not command.of_cluster]


def pairs_of(options, can_mount):
    """Return all pairs of a command and a fault that suit each other, in an order drawn once."""
    pairs = [
        (name, kind)
        for kind in options.faults
        for name in options.commands
        if suits(FAULTS[kind], COMMANDS[name]) and (can_mount or not FAULTS[kind].mounts)
    ]
    random.Random(options.seed).shuffle(pairs)
    return pairs


def main():
    """Do the trials and print a report."""
    parser = argparse.ArgumentParser(
        prog="tools/trials", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0, help="seed of the pairs and the moments")
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=LOCAL)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--minutes", type=float, help="begin no trial after so long")
    parser.add_argument("--only", type=int, metavar="N", help="number of the only trial to do")
    options = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):  # a job in the background would ignore Ctrl-C,
        signal.signal(number, signal.default_int_handler)  # and so would the commands
    done, wrong, late, begun = Counter(), Counter(), 0, time.monotonic()
    slowest = defaultdict(float)
    with (
        tempfile.TemporaryDirectory(prefix="twinct-trials-") as name,
        ExitStack() as stack,
    ):
        trials = Trials(Path(name) / "all", options.commands, stack)
        pairs = pairs_of(options, trials.can_mount)
        for number in range(options.trials) if options.only is None else [options.only]:
            if options.minutes and time.monotonic() - begun > 60 * options.minutes:
                break
            command, kind = pairs[number % len(pairs)]
            fired, codes, found, gone_s = trials.trial(command, kind, f"{options.seed} {number}")
            slowest[kind] = max(slowest[kind], gone_s or 0.0)
            done[kind] += 1
            wrong[kind] += bool(found)
            late += not fired
            words = "WRONG" if found else "passed" if fired else "passed, the fault came too late"
            print(f"{number:4}  {command:18}  {kind:28}  exit code {codes}: {words}", flush=True)
            for one in found:
                print(f"      {one}", flush=True)
            if found:
                again = shlex.join([*sys.argv[1:], "--only", str(number)])
                print(f"      again: python tools/trials {again}", flush=True)
    skipped = [kind for kind in options.faults if FAULTS[kind].mounts and not trials.can_mount]
    print(f"\n{'fault':28}  trials  passed  no process left after, at most")
    for kind, count in sorted(done.items()):
        after = f"  {slowest[kind]:.1f} s" if FAULTS[kind].ends else ""
        print(f"{kind:28}  {count:6}  {count - wrong[kind]:6}{after}")
    print(f"{done.total() - wrong.total()} of {done.total()} passed; in {late} the fault came late")
    if skipped:
        print(f"skipped, as this process may not mount disks: {', '.join(skipped)}; /dev/shm")
    return 1 if wrong.total() else 0


if __name__ == "__main__":
    sys.exit(main())
