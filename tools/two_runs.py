"""Start two runs in one folder at nearly the same time, repeatedly.

python tools/two_runs.py --trials 20 --seed 1

The second run starts 0 to 2 s after the first. One must succeed, with a report and with the same
files and bytes in its store as an undisturbed run. The other must end with exit code 2 and a
message that names the process in the folder or says that a scan exists. No lock, partial file or
process may remain. In one trial in four, both runs resume a killed scan, and both may succeed in
turn. The exit code is 1 otherwise.
"""

import argparse
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path

from kill_trials import alive, contents, said, start, views_on_disk

VIEWS = 12
MORE = ("--set", f"trajectory.views={VIEWS}")
LATEST_S = 2.0
A_RESUMED_TRIAL = 4


def killed(out, mark, views):
    """Start a scan and kill it after a number of views."""
    process = start(out, mark, *MORE)
    while views_on_disk(out) < views and process.poll() is None:
        time.sleep(0.01)
    process.kill()
    said(process)
    process.wait()
    while alive(mark):
        time.sleep(0.02)


def trial(folder, number, expected, seed):
    """Run one pair; return its delay (s), whether it resumes, the winner and the faults."""
    moments = random.Random(f"{seed} {number}")
    out, mark = folder / f"pair{number}", f"pair{number}"
    resumed = number % A_RESUMED_TRIAL == A_RESUMED_TRIAL - 1
    if resumed:
        killed(out, mark, moments.randrange(1, VIEWS - 1))
    apart_s = moments.uniform(0, LATEST_S)
    more = (*MORE, "--resume") if resumed else MORE
    first = start(out, mark, *more)
    time.sleep(apart_s)
    pair = [first, start(out, mark, *more)]
    words = [said(process) for process in pair]
    codes = [process.wait() for process in pair]
    faults = []
    if sorted(codes) != [0, 2] and not (resumed and codes == [0, 0]):
        faults.append(f"exit codes {codes}")
    for code, word in zip(codes, words, strict=True):
        if code and not ("is using this folder" in word or "already holds" in word):
            faults.append(f"the loser said {word}")
    if not (out / "report.html").exists() or contents(out / "scan.zarr") != expected:
        faults.append("the store differs from an undisturbed one, or the report is missing")
    if left := sorted(p.name for p in out.iterdir() if "lock" in p.name or "partial" in p.name):
        faults.append(f"left {', '.join(left)}")
    if alive(mark):
        faults.append(f"left {alive(mark)}")
    shutil.rmtree(out, ignore_errors=True)
    winner = (
        "both, one after the other" if codes == [0, 0] else f"run {1 + codes.index(min(codes))}"
    )
    return apart_s, resumed, winner, faults


def main():
    """Run the trials and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
    options = parser.parse_args()
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        undisturbed = start(folder / "whole", "whole", *MORE)
        if complaint := said(undisturbed) if undisturbed.wait() else "":
            raise SystemExit(complaint)
        expected = contents(folder / "whole" / "scan.zarr")
        print("pair  apart   of          finished by                 faults")
        for number in range(options.trials):
            apart_s, resumed, winner, faults = trial(folder, number, expected, options.seed)
            of = "two resumes" if resumed else "two runs"
            told = "; ".join(faults) or "none"
            print(f"{number:4}  {apart_s:.2f} s  {of:11} {winner:27} {told}", flush=True)
            bad += bool(faults)
    print(f"{options.trials - bad} of {options.trials} pairs without faults")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
