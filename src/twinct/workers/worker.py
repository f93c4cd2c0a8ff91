"""Worker process of a local pool, which executes work sequentially in its main thread.

Only ``twinct.workers.local`` starts it, by ``python -m twinct.workers.worker CONNECTION LIFELINE
THREADS FOLDER``.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path

from twinct.core.threads import limit_threads
from twinct.workers.call import call
from twinct.workers.lifeline import end_with
from twinct.workers.work import Place


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
        event = call(request, Place(Path(sys.argv[4]), threads, inputs.__getitem__))
        pool.send_bytes(pickle.dumps(event))
        del request, event


if __name__ == "__main__":
    main()
