"""Stop processes of running scans (SIGSTOP) at random times, resume the scans and compare stores.

python tools/stop_processes.py --trials 10 --jobs 2

Each of the three processes of ``twinct run`` (scan, robots, xray) is stopped shortly after a number
of views, drawn uniformly, is on disk. A stopped node must be detected, named and ended together
with the scan. If the scan is stopped, its nodes must end, and the scan must report the reason once
it continues. ``twinct run --resume`` must then give the same files and bytes as an undisturbed run.
The exit code is 1 otherwise.
"""

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from kill_trials import (
    A_LITTLE_S,
    PATIENCE_S,
    TO_END_S,
    VICTIMS,
    alive,
    contents,
    said,
    start,
    victim_pid,
    views_on_disk,
)

VIEWS = 36
MORE = ("--set", f"trajectory.views={VIEWS}")


def trial(folder, victim, number, expected, seed):
    """Stop one process and return observations; a stopped scan is noticed when its nodes end."""
    moments = random.Random(f"{seed} {victim} {number}")
    for attempt in range(20):
        mark = f"{victim}-{number}-{attempt}"
        out = folder / mark
        process = start(out, mark, *MORE)
        wanted = moments.randrange(VIEWS - 2)
        while (pid := victim_pid(victim, process, mark)) is None and process.poll() is None:
            time.sleep(0.02)
        while views_on_disk(out) <= wanted and process.poll() is None:
            time.sleep(0.01)
        time.sleep(moments.uniform(0, A_LITTLE_S))
        gone = process.poll() is not None or victim_pid("robots", process, mark) is None
        if pid is None or gone:
            process.wait()  # already ended: try another time
            shutil.rmtree(out, ignore_errors=True)
            continue
        os.kill(pid, signal.SIGSTOP)
        stopped, views = time.monotonic(), views_on_disk(out)
        others = {pid} if victim == "scan" else set()
        noticed_s = None
        while (there := alive(mark).keys()) - others and time.monotonic() - stopped < PATIENCE_S:
            if noticed_s is None and pid not in there:  # the scan has ended the stopped node
                noticed_s = time.monotonic() - stopped
            process.poll()
            time.sleep(0.02)
        ended_s = time.monotonic() - stopped
        if victim == "scan":
            os.kill(pid, signal.SIGCONT)
        message = said(process)
        finished = process.wait() == 0  # the stopped node had no work left
        words = "was silent" if victim == "scan" else f"the {victim} node hung or was stop"
        named = (words in message or finished) and "Traceback" not in message
        resumed = start(out, mark, *MORE, "--resume")
        complaint = said(resumed)
        equal = resumed.wait() == 0 and contents(out / "scan.zarr") == expected
        shutil.rmtree(out, ignore_errors=True)
        return {
            "views": views,
            "ended_s": ended_s,
            "noticed_s": noticed_s or ended_s,
            "left": len(alive(mark)),
            "named": named,
            "equal": equal,
            "words": "" if named and equal else message + complaint,
        }
    raise SystemExit(f"{victim}: every run ended before it could be stopped")


def main():
    """Run the trials and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
    parser.add_argument("--victims", nargs="+", choices=VICTIMS, default=VICTIMS)
    options = parser.parse_args()
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        undisturbed = start(folder / "whole", "whole", *MORE)
        if complaint := said(undisturbed) if undisturbed.wait() else "":
            raise SystemExit(complaint)
        expected = contents(folder / "whole" / "scan.zarr")
        print(
            "process  stopped  store equal  named  left over  noticed  ended    views on disk then"
        )
        for victim in options.victims:
            with ThreadPoolExecutor(options.jobs) as pool:
                jobs = [
                    pool.submit(trial, folder, victim, n, expected, options.seed)
                    for n in range(options.trials)
                ]
                results = [job.result() for job in jobs]
            noticed, ended = (max(r[k] for r in results) for k in ("noticed_s", "ended_s"))
            counts = {key: sum(r[key] for r in results) for key in ("equal", "named", "left")}
            views = sorted(r["views"] for r in results)
            print(
                f"{victim:7}  {len(results):7}  {counts['equal']:11}  {counts['named']:5}"
                f"  {counts['left']:9}  {noticed:5.1f} s  {ended:5.1f} s",
                *views,
                flush=True,
            )
            for words in (r["words"] for r in results if r["words"]):
                print(words, file=sys.stderr)
            bad += 2 * len(results) - counts["equal"] - counts["named"] + counts["left"]
            bad += noticed > TO_END_S
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
