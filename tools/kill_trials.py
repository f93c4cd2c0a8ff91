"""Kill processes of running scans at random times, resume the scans and compare the stores.

python tools/kill_trials.py --trials 20 --jobs 3

Each of the three processes of ``twinct run`` (scan, robots, xray) is killed by SIGKILL in its own
trials. When the other processes have ended, ``twinct run --resume`` follows. One kill in five comes
at a time drawn uniformly from the life of the process, the others come shortly after a number of
views, drawn uniformly, is on disk. The store must have the same files and bytes as that of an
undisturbed run. The exit code is 1 otherwise.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
KEYS = {
    "trajectory.views": 72,
    "detector.columns": 160,
    "detector.rows": 120,
    "reconstruction.grid.voxels": 32,
    "reconstruction.grid.voxel_mm": 4.96,
    "reconstruction.iterations": 2,
}
VICTIMS = ("scan", "robots", "xray")
MARK = "TWINCT_KILL_TRIAL"
ANY_MOMENT = 0.2
A_LITTLE_S = 0.3
TO_END_S = 10.0
PATIENCE_S = 300.0


def command(out, *more):
    """Return the command line of a scan into a folder."""
    keys = [word for key, value in KEYS.items() for word in ("--set", f"{key}={value}")]
    scenario = str(ROOT / "scenarios" / "demo.yaml")
    return [sys.executable, "-m", "twinct", "run", scenario, "--out", str(out), *keys, *more]


def start(out, mark, *more):
    """Start a scan with a mark in the environment of its processes."""
    return subprocess.Popen(
        command(out, *more),
        env=os.environ | {MARK: mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def alive(mark):
    """Return the command lines, by pid, of all processes of a trial, which inherit its mark."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes().split(b"\0")
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if f"{MARK}={mark}".encode() in environment and any(words):
            found[int(folder.name)] = b" ".join(words).decode()
    return found


def victim_pid(victim, process, mark):
    """Return the pid of the process to kill, or None if it is not running."""
    if victim == "scan":
        return process.pid
    wanted = f"twinct.link {victim} "
    return next((pid for pid, line in alive(mark).items() if wanted in line), None)


def contents(path):
    """Return the bytes of all files below a folder, by relative path."""
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def views_on_disk(out):
    """Return the number of views that a scan in a folder has finished."""
    return len(list(out.glob("scan.zarr/status/c.*")))


def lives(folder):
    """Return the lifetime of each process in an undisturbed run, s."""
    process, mark = start(folder / "timed", "timed"), "timed"
    begun, seen = {"scan": time.monotonic()}, {}
    while process.poll() is None:
        for victim in VICTIMS:
            if victim_pid(victim, process, mark) is not None:
                begun.setdefault(victim, time.monotonic())
                seen[victim] = time.monotonic() - begun[victim]
        time.sleep(0.05)
    assert process.returncode == 0, said(process)
    return seen


def said(process):
    """Return the complete stderr of a process."""
    assert process.stderr is not None
    return process.stderr.read()


def trial(folder, victim, number, life, expected):
    """Kill one process, resume the scan and return the observations."""
    moments = random.Random(f"{victim} {number}")
    for attempt in range(20):
        mark = f"{victim}-{number}-{attempt}"
        out = folder / mark
        process = start(out, mark)
        while (pid := victim_pid(victim, process, mark)) is None and process.poll() is None:
            time.sleep(0.02)
        if moments.random() < ANY_MOMENT:
            time.sleep(moments.uniform(0, life))
        else:
            wanted = moments.randrange(KEYS["trajectory.views"])
            while views_on_disk(out) < wanted and process.poll() is None:
                time.sleep(0.01)
            time.sleep(moments.uniform(0, A_LITTLE_S))
        if pid is None or process.poll() is not None or pid not in alive(mark):
            process.wait()  # already ended: try another time
            shutil.rmtree(out, ignore_errors=True)
            continue
        os.kill(pid, signal.SIGKILL)
        killed = time.monotonic()
        views = views_on_disk(out)
        while alive(mark) and time.monotonic() - killed < PATIENCE_S:
            process.poll()
            time.sleep(0.02)
        ended_s = time.monotonic() - killed
        left = len(alive(mark))
        message = said(process)
        named = victim == "scan" or (victim in message and "Traceback" not in message)
        if process.wait() == 0:  # the node was killed after it had finished its work
            named = True
        resumed = start(out, mark, "--resume")
        complaint = said(resumed)
        good = resumed.wait() == 0
        equal = good and contents(out / "scan.zarr") == expected
        shutil.rmtree(out, ignore_errors=True)
        return {
            "views": views,
            "ended_s": ended_s,
            "left": left + len(alive(mark)),
            "named": named,
            "equal": equal,
            "words": "" if named and equal else message + complaint,
        }
    raise SystemExit(f"{victim}: every run ended before it could be killed")


def main():
    """Run the trials and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--victims", nargs="+", choices=VICTIMS, default=VICTIMS)
    options = parser.parse_args()
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        life = lives(folder)
        expected = contents(folder / "timed" / "scan.zarr")
        print("process  killed  store equal  named  left over  slowest end  views on disk then")
        for victim in options.victims:
            with ThreadPoolExecutor(options.jobs) as pool:
                results = list(
                    pool.map(
                        lambda n, v=victim: trial(folder, v, n, life[v], expected),
                        range(options.trials),
                    )
                )
            slowest = max(r["ended_s"] for r in results)
            counts = {key: sum(r[key] for r in results) for key in ("equal", "named", "left")}
            views = sorted(r["views"] for r in results)
            print(
                f"{victim:7}  {len(results):6}  {counts['equal']:11}  {counts['named']:5}"
                f"  {counts['left']:9}  {slowest:9.1f} s  {' '.join(map(str, views))}",
                flush=True,
            )
            for words in (r["words"] for r in results if r["words"]):
                print(words, file=sys.stderr)
            bad += 2 * len(results) - counts["equal"] - counts["named"] + counts["left"]
            bad += slowest > TO_END_S
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
