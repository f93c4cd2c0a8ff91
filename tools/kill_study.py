"""Kill processes of a study at random times, resume it, and compare it with an undisturbed one.

python tools/kill_study.py --workers 20 --nodes 5 --drivers 5
python tools/kill_study.py --pool local --workers 20 --drivers 5

Each seed has five trials: one with its own scan, and four that share another scan. The study runs
on a simulated cluster of two nodes (``ray.cluster_utils``) in a separate process, or on local
processes. ``kill -9`` hits a busy worker, all processes of the second node (which returns some
seconds later), or the driver, which is then restarted with ``--resume``. The victim is killed
shortly after the journal has reached a number of rows, drawn uniformly; one in five drivers is
killed during its start. All rows must equal the undisturbed rows except in seconds, no row may be
missing or duplicated, and no process may outlive its driver or the test. The exit code is 1
otherwise.

A driver gives up a trial that has killed its worker three times. Here no driver sees more than two
killed workers, so no trial can reach three by chance.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from kill_trials import ROOT

from twinct import load_results
from twinct.study.journal import Journal

STUDY = {
    "scenario": str(ROOT / "scenarios" / "circle_gantry.yaml"),
    "set": {
        "specimen.parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 4}}],
        "detector.noise": {"kind": "snr", "snr": 100.0},
        "detector.columns": 64,
        "detector.rows": 48,
        "reconstruction.grid": {"voxels": 24, "voxel_mm": 6.6},
    },
}
MARK = "TWINCT_KILL_STUDY"
MEMORY_BYTES = 2**32
WORKERS_A_DRIVER = 2
IN_THE_START = 0.2
START_S = 10.0
A_LITTLE_S = 0.3
AWAY_S = (1.0, 4.0)
TO_END_S = 10.0
PATIENCE_S = 900.0


def study(seeds):
    """Return a study with five trials for each seed."""
    relaxations = {"key": "reconstruction.relaxation", "values": [0.1, 0.3, 0.5, 0.7]}
    return STUDY | {
        "axes": [
            {"key": "trajectory.views", "values": [4, 8]},
            {"key": "seed", "label": "noise", "values": list(range(seeds))},
            relaxations | {"only": {"trajectory.views": 8}},
        ]
    }


def alive(*marks):
    """Return the command lines, by pid, of all processes with every mark in their environment."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes().split(b"\0")
            line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
        except OSError:
            continue
        if line and all(mark.encode() in environment for mark in marks):
            found[int(folder.name)] = line
    return found


def until_none(processes, patience_s=TO_END_S):
    """Wait until a function returns no processes; return the seconds and the remaining ones."""
    begun = time.monotonic()
    while (left := processes()) and time.monotonic() - begun < patience_s:
        time.sleep(0.02)
    return time.monotonic() - begun, list(left.values())


class LocalProcesses:
    """Workers of the local pool."""

    words = ("--jobs", "2")

    def __init__(self, mark):
        self.mark = mark

    def workers(self):
        """Return the workers that a driver has started."""
        return {p: line for p, line in alive(self.mark).items() if "twinct.workers.worker" in line}

    busy = workers

    def close(self):
        """Do nothing: all processes belong to the driver."""


class SimulatedCluster:
    """Cluster of two nodes, each with its own folder."""

    def __init__(self, mark, folder):
        self.mark, self._second = mark, f"TWINCT_CACHE={folder / 'second'}"
        program = ROOT / "tests" / "cluster" / "simulated.py"
        folder.mkdir()
        with (folder / "log").open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, str(program), str(folder), str(MEMORY_BYTES)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                process_group=0,
                text=True,
            )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._steer, self._said = self._process.stdin, self._process.stdout
        self.words = ("--address", self._said.readline().strip())
        if not self.words[1]:
            raise SystemExit((folder / "log").read_text())

    def workers(self):
        """Return the busy and idle workers of a driver."""
        titles = alive(self.mark).items()
        return {p: t for p, t in titles if t.startswith("ray::") and "Agent" not in t}

    def busy(self):
        """Return the busy workers."""
        return {p: title for p, title in self.workers().items() if title.startswith("ray::twinct")}

    def lose_node(self, away_s):
        """Kill the second node, starting with its raylet, which represents it to the cluster."""
        processes = alive(self.mark, self._second)
        for pid in sorted(processes, key=lambda pid: "/raylet " not in processes[pid]):
            kill(pid)
        time.sleep(away_s)
        for word in ("remove", "add"):
            print(word, file=self._steer, flush=True)
            assert self._said.readline().strip() == word

    def close(self):
        """Shut the cluster down regularly."""
        self._steer.close()
        self._process.wait(PATIENCE_S)


def kill(pid):
    """Send SIGKILL to a process; return False if it no longer exists."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


class Trials:
    """A study that is run repeatedly.

    Attributes:
        killed: number of kills of each kind of victim.
        slowest_s: longest time from the end of a driver to the end of its last worker.
        left: command lines of the processes that outlived their driver.
    """

    def __init__(self, folder, seeds, site):
        self.folder, self.site, self.number = folder, site, 5 * seeds
        self.file = folder / "study.json"
        self.file.write_text(json.dumps(study(seeds)))
        self.killed, self.slowest_s, self.left = Counter(), 0.0, []
        self.expected = None

    def start(self, out, *more):
        """Start a driver."""
        words = ["study", str(self.file), "--out", str(out), *self.site.words, *more]
        with out.with_suffix(".log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "twinct", *words], stdout=log, stderr=log, process_group=0
            )

    def end(self, driver):
        """Wait for a driver and its workers; return True if it succeeded."""
        try:
            code = driver.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            driver.kill()
            code = driver.wait()
        seconds, left = until_none(self.site.workers)
        self.slowest_s = max(self.slowest_s, seconds)
        self.left += left
        return code == 0

    def run(self, name, plan, moments):
        """Run one study with its kills and print its table row; return True if it passes."""
        out, begun, before = self.folder / name, time.monotonic(), Counter(self.killed)
        driver = self.start(out)
        for rows, victim in plan:
            if victim == "driver" and moments.random() < IN_THE_START:
                time.sleep(moments.uniform(0, START_S))
            else:
                while journalled(out) < rows and driver.poll() is None:
                    time.sleep(0.02)
                time.sleep(moments.uniform(0, A_LITTLE_S))
            if driver.poll() is not None:
                break
            if victim == "worker":
                while not (busy := sorted(self.site.busy())) and driver.poll() is None:
                    time.sleep(0.05)
                self.killed[victim] += bool(busy) and kill(moments.choice(busy))
            elif victim == "node":
                self.site.lose_node(moments.uniform(*AWAY_S))
                self.killed[victim] += 1
            else:
                driver.kill()
                self.killed[victim] += 1
                self.end(driver)
                driver = self.start(out, "--resume")
        good, seconds = self.end(driver), time.monotonic() - begun
        rows = {row.key: dataclasses.replace(row, seconds={}) for row in Journal(out).rows()}
        if not (out / "journal.jsonl").exists():
            raise SystemExit(out.with_suffix(".log").read_text())
        lines = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
        done = Counter(line["key"] for line in lines if line["status"] == "done")
        self.expected = self.expected or rows
        equal = sum(rows.get(key) == row for key, row in self.expected.items())
        lost, twice = self.number - len(done), done.total() - len(done)
        good &= equal == self.number and not lost and not twice and len(lines) == self.number
        good &= [row.key for row in rows.values()] == load_results(out).key.tolist()
        kills = self.killed - before
        print(
            f"{name:11}  {kills['worker']:7}  {kills['node']:4}  {kills['driver']:6}  {equal:10}"
            f"  {lost:4}  {twice:5}  {seconds:5.0f} s",
            flush=True,
        )
        if not good:
            print(out.with_suffix(".log").read_text(), file=sys.stderr)
            print((out / "study.log").read_text(), file=sys.stderr)
        return good


def journalled(out):
    """Return the number of rows in the journal of a study."""
    try:
        return (out / "journal.jsonl").read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


def plan_of(left, number, moments):
    """Return the kills of one study as (rows, victim): driver, node and several workers.

    No kill falls into the last fifth, as the study might end before it.
    """
    late = number - number // 5
    middle = moments.randrange(late + 1) if left["driver"] > 0 else number
    lives = [(0, middle), (middle, number)] if left["driver"] > 0 else [(0, number)]
    kills = [
        (moments.randrange(first, max(first, min(last, late)) + 1), "worker", life)
        for life, (first, last) in enumerate(lives)
        for _ in range(WORKERS_A_DRIVER)
    ][: max(left["worker"], 0)]
    kills += [(middle, "driver", 0.5)] if left["driver"] > 0 else []
    if left["node"] > 0:
        rows = moments.randrange(late)
        kills.append((rows, "node", int(rows >= middle)))
    return [(rows, victim) for rows, victim, _ in sorted(kills, key=lambda k: (k[2], k[0]))]


def main():
    """Run the studies and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pool", choices=("cluster", "local"), default="cluster")
    parser.add_argument("--workers", type=int, default=20)
    parser.add_argument("--nodes", type=int, default=5)
    parser.add_argument("--drivers", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=12, help="number of seeds, five trials each")
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
    options = parser.parse_args()
    wanted = {"worker": options.workers, "node": options.nodes, "driver": options.drivers}
    wanted["node"] *= options.pool == "cluster"
    moments = random.Random(options.seed)
    token = secrets.token_hex(16)
    mark = f"{MARK}={token}"
    os.environ |= {MARK: token, "TWINCT_THREADS": "1", "RAY_USAGE_STATS_ENABLED": "0"}
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    os.environ["RAY_worker_niceness"] = "0"  # otherwise other load starves Ray's workers
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        cluster = options.pool == "cluster"
        site = SimulatedCluster(mark, folder / "nodes") if cluster else LocalProcesses(mark)
        stack.callback(site.close)
        trials = Trials(folder, options.seeds, site)
        print("study        workers  node  driver  rows equal  lost  twice  seconds")
        good = trials.run("undisturbed", [], moments)
        left = Counter(wanted)
        for number in range(1, 1 + 10 * max(wanted.values())):  # some kills come too late
            if not any(count > 0 for count in left.values()):
                break
            good &= trials.run(f"killed {number}", plan_of(left, trials.number, moments), moments)
            left = Counter(wanted)
            left.subtract(trials.killed)
        stack.close()
        own = os.getpid()
        seconds, rest = until_none(lambda: {p: s for p, s in alive(mark).items() if p != own})
    killed = ", ".join(f"{victim} {trials.killed[victim]} of {n}" for victim, n in wanted.items())
    print(f"killed: {killed}; workers gone at most {trials.slowest_s:.1f} s after their driver")
    print(f"left over: {len(trials.left)} of a driver, {len(rest)} at the end")
    print("\n".join([*trials.left, *rest]), file=sys.stderr)
    good &= not trials.left and not rest and all(count <= 0 for count in left.values())
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
