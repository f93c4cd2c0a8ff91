"""Let faults meet commands of twinct while they work, and see what the commands leave behind.

    python tools/trials --trials 400 --seed 1
    python tools/trials --trials 20 --commands run study --faults SIGKILL Ctrl-C
    python tools/trials --seed 1 --only 17
    python tools/trials --seed 1 --journal out/trials.jsonl

Each trial runs a command on a tiny scenario until a fault meets it at a drawn moment (a signal to
the command or to a process of it, a disk that fills up, a clock that jumps), or under a condition
that holds all along (few descriptors, little memory, no HOME, ...). The command must end with the
right exit code and message, without a traceback; no result may be damaged, no process, shared
memory or draft may be left. Then the command is continued with --resume, or repeated: it must make
nothing again that is there already, and end with the bytes of an undisturbed command. The exit code
is 1 otherwise, and the words that repeat a failed trial are printed. A trial whose fault comes too
late to disturb the command is drawn again; if that does not help, it does not count. Conditions
that need the right to mount disks are skipped without it, and so is the look into /dev/shm. A study
on a cluster, by Ray, is tried only if it is named, and has no other trial beside it. With a
journal, trials that are in it already are not done again, but count in the report.
"""

import argparse
import json
import multiprocessing
import random
import shlex
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack, suppress
from pathlib import Path

from commands import COMMANDS
from faults import FAULTS, suits
from trial import Trials

LOCAL = [name for name, command in COMMANDS.items() if not command.of_cluster]

WORK = []
"""Calls of ``in_processes``; its processes inherit them."""


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


def in_processes(jobs, function, all_arguments):
    """Yield the results of a function for some arguments, as they come, from forks of this one."""
    WORK[:] = [(function, arguments) for arguments in all_arguments]
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("fork")) as pool:
        try:
            for done in as_completed([pool.submit(work, index) for index in range(len(WORK))]):
                yield done.result()
        finally:
            pool.shutdown(cancel_futures=True)


def work(index):
    """Do one call of ``in_processes``."""
    function, arguments = WORK[index]
    return function(*arguments)


class Journal:
    """A file with a line of JSON for each done trial; without a path, nothing is kept."""

    def __init__(self, path, seed):
        """Take the trials of an earlier call."""
        self.path, self.seed, self.done = path, seed, {}
        if path and path.exists():
            rows = [json.loads(line) for line in path.read_text().splitlines()]
            self.done = {told[0]: told for own, *told in rows if own == seed}

    def add(self, told):
        """Keep a trial."""
        if self.path:
            with self.path.open("a") as file:
                file.write(json.dumps([self.seed, *told]) + "\n")

    def known(self, number, command, kind):
        """Return True if a trial is done.

        Raises:
            SystemExit: the journal has other trials by these numbers.
        """
        if (told := self.done.get(number)) and told[1:3] != [command, kind]:
            raise SystemExit(f"{self.path}: trial {number} was {told[1]}, {told[2]}: take another")
        return number in self.done


class Report:
    """The report of all trials."""

    def __init__(self):
        """Begin with no trials."""
        self.done, self.wrong, self.late, self.again = Counter(), Counter(), 0, 0
        self.slowest = defaultdict(float)

    def add(self, number, command, kind, in_time, codes, found, gone_s, draws):
        """Print a trial, and count it unless its fault came too late."""
        counts = in_time or found
        self.again += draws - 1
        self.late += not counts
        self.done[kind] += bool(counts)
        self.wrong[kind] += bool(found)
        self.slowest[kind] = max(self.slowest[kind], gone_s or 0.0)
        words = "WRONG" if found else "passed" if in_time else "the fault came too late"
        print(f"{number:4}  {command:18}  {kind:28}  exit code {codes}: {words}", flush=True)
        for one in found:
            print(f"      {one}", flush=True)
        if found:
            again = shlex.join([*sys.argv[1:], "--only", str(number)])
            print(f"      again: python tools/trials {again}", flush=True)

    def conclude(self, skipped):
        """Print the sums; ``skipped`` are faults that need disks."""
        print(f"\n{'fault':28}  trials  passed  no process left after, at most")
        for kind, count in sorted(self.done.items()):
            after = f"  {self.slowest[kind]:.1f} s" if FAULTS[kind].ends else ""
            print(f"{kind:28}  {count:6}  {count - self.wrong[kind]:6}{after}")
        total, wrong = self.done.total(), self.wrong.total()
        print(
            f"{total - wrong} of {total} passed; {self.again} were drawn again, and in {self.late} "
            "others the fault came too late"
        )
        if skipped:
            print(f"skipped, as this process may not mount disks: {', '.join(skipped)}; /dev/shm")


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
    parser.add_argument("--jobs", type=int, default=1, help="trials at a time")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first")
    parser.add_argument("--journal", type=Path, metavar="FILE", help="goes on from what it holds")
    parser.add_argument("--only", type=int, metavar="N", help="number of the only trial to do")
    options = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):  # a job in the background ignores Ctrl-C, one of
        signal.signal(number, signal.default_int_handler)  # nohup the end of its terminal, and so
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # would the commands
    begun, report = time.monotonic(), Report()
    with (
        tempfile.TemporaryDirectory(prefix="twinct-trials-") as name,
        ExitStack() as stack,
    ):
        trials = Trials(Path(name) / "all", options.commands, stack)
        pairs, jobs = pairs_of(options, trials.can_mount), 1 if trials.cluster else options.jobs
        numbers = [options.only] if options.only is not None else range(options.trials)
        chosen = [(n, *pairs[n % len(pairs)]) for n in numbers if n >= options.first]
        journal = Journal(options.journal, options.seed)
        for told in [journal.done[one[0]] for one in chosen if journal.known(*one)]:
            report.add(*told)
        chosen = [one for one in chosen if one[0] not in journal.done]
        used = dict.fromkeys((command,) for _, command, _ in chosen)
        trials.whole = dict(in_processes(jobs, trials.undisturbed, used))

        def one(number, command, kind):
            if options.minutes and time.monotonic() - begun > 60 * options.minutes:
                return None
            return number, command, kind, *trials.trial(command, kind, f"{options.seed} {number}")

        with suppress(KeyboardInterrupt):
            for told in in_processes(jobs, one, chosen):
                if told:
                    journal.add(told)
                    report.add(*told)
    report.conclude([k for k in options.faults if FAULTS[k].mounts and not trials.can_mount])
    return 1 if report.wrong.total() else 0


if __name__ == "__main__":
    sys.exit(main())
