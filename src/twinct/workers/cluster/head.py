"""Ray on this machine for a single parent process, with whose end it ends.

Only ``twinct.workers.cluster.local`` starts it, by ``python -m twinct.workers.cluster.head LIFELINE
OPTION...``, with the options of ``ray start``. It says ``up`` once Ray is there. The kernel kills
Ray's processes, which belong to its group, with the parent.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib.metadata import entry_points

from twinct.workers.lifeline import end_with


def main() -> None:
    """Start Ray, say so, and wait to be killed."""
    end_with(os.open(sys.argv[1], os.O_RDONLY | os.O_NONBLOCK))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    report = os.dup(1)
    os.dup2(2, 1)  # what Ray prints goes to the log
    sys.argv = ["ray", "start", *sys.argv[2:]]
    (command,) = entry_points(group="console_scripts", name="ray")
    try:
        command.load()()
    except SystemExit as end:
        if end.code:
            raise
    os.write(report, b"up\n")
    while True:
        signal.pause()


if __name__ == "__main__":
    main()
