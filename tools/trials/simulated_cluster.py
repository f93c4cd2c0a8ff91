"""A simulated cluster of two nodes, whose workers and second node a trial may kill."""

import os
import secrets
import signal
import subprocess
import sys
from contextlib import suppress

from commands import ROOT
from processes import MARK, PATIENCE_S, alive, until

MEMORY_BYTES = 2**32


class SimulatedCluster:
    """Two nodes on this machine (``ray.cluster_utils``), each with its own folder."""

    def __init__(self, folder):
        """Start the cluster; drivers find its token in this process's environment."""
        folder.mkdir()
        self._mark, self._second = secrets.token_hex(16), folder / "second"
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
        os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "TWINCT_THREADS": "1"}
        program = ROOT / "tests" / "cluster" / "simulated.py"
        with (folder / "log").open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, str(program), str(folder), str(MEMORY_BYTES)],
                # Other load starves workers that are as nice as Ray makes them.
                env=os.environ | {MARK: self._mark, "RAY_worker_niceness": "0"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                process_group=0,
                text=True,
            )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._steer, self._said = self._process.stdin, self._process.stdout
        self.address = self._said.readline().strip()
        if not self.address:
            raise SystemExit((folder / "log").read_text())

    def workers(self):
        """Return the command lines of a driver's workers, by pid; those at work name a function."""
        titles = alive(self._mark).items()
        return {p: t for p, t in titles if t.startswith("ray::") and "Agent" not in t}

    def kill_worker(self, rng, over):
        """Kill a worker at work, unless ``over`` returns True before there is one."""

        def busy():
            return sorted(p for p, title in self.workers().items() if "ray::twinct" in title)

        until(lambda: busy() or over())
        for pid in busy()[:1] if rng.random() < 0.5 else busy()[-1:]:
            kill(pid)

    def lose_node(self, rng, over):
        """Kill the second node, and let another one come."""
        # The raylet first, which represents the node to the cluster.
        processes = alive(f"{self._second}", "TWINCT_CACHE")
        for pid in sorted(processes, key=lambda pid: "/raylet " not in processes[pid]):
            kill(pid)
        until(lambda: not alive(f"{self._second}", "TWINCT_CACHE"))
        for word in ("remove", "add"):
            print(word, file=self._steer, flush=True)
            assert self._said.readline().strip() == word

    def close(self):
        """Shut the cluster down; return the processes that it leaves."""
        self._steer.close()
        self._process.wait(PATIENCE_S)
        until(lambda: not alive(self._mark), 15.0)
        return list(alive(self._mark).values())


def kill(pid):
    """Send SIGKILL to a process, if it still exists."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
