"""Worker process of a local pool, which executes work sequentially in its main thread.

Only ``twinct.workers.local`` starts it, by ``python -m twinct.workers.worker CONNECTION LIFELINE
THREADS FOLDER``.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

from twinct.core.threads import limit_threads
from twinct.workers.call import call
from twinct.workers.lifeline import end_with


@dataclass(frozen=True)
class LocalPlace:
    """Place of work on this machine; offers are used at their original paths."""

    folder: Path
    threads: int
    inputs: Mapping[str, Path]
    attached: dict[str, Path] = field(default_factory=dict[str, Path])

    def fetch(self, name: str) -> Path:
        """Return the path of an offer."""
        return self.inputs[name]

    def attach(self, name: str, path: Path) -> None:
        """Send a file or folder back."""
        self.attached[name] = path


def main() -> None:
    """Execute work until the pool ends."""
    connection, lifeline, threads = map(int, sys.argv[1:4])
    os.set_inheritable(connection, False)
    end_with(lifeline)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pool handles Ctrl-C and ends its workers
    limit_threads(threads)
    pool = Connection(connection)
    while True:
        request, inputs = pickle.loads(pool.recv_bytes())
        event = call(request, LocalPlace(Path(sys.argv[4]), threads, inputs))
        pool.send_bytes(pickle.dumps(event))
        del request, event


if __name__ == "__main__":
    main()
