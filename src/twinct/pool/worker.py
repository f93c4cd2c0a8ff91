"""A worker of a pool on this machine: one piece of work after another, in its main thread.

``python -m twinct.pool.worker CONNECTION LIFELINE THREADS FOLDER``, by ``twinct.pool.local`` only.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from twinct.pool.call import call
from twinct.pool.lifeline import end_with
from twinct.threads import limit_threads


@dataclass(frozen=True)
class LocalPlace:
    """A folder of this machine; what was offered is where it was."""

    folder: Path
    threads: int
    inputs: Mapping[str, Path]

    def fetch(self, name: str) -> Path:
        """What was offered."""
        return self.inputs[name]


def main() -> None:
    """Work until the pool is gone."""
    connection, lifeline, threads = map(int, sys.argv[1:4])
    os.set_inheritable(connection, False)
    end_with(lifeline)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the pool's: it ends its workers
    limit_threads(threads)
    pool = Connection(connection)
    while True:
        request, inputs = pickle.loads(pool.recv_bytes())
        outcome = call(request, LocalPlace(Path(sys.argv[4]), threads, inputs))
        pool.send_bytes(pickle.dumps(outcome))
        del request, outcome


if __name__ == "__main__":
    main()
