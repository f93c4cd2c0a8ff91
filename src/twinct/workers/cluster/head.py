"""Ray on this machine for a single parent process, with whose end it ends.

Only ``twinct.workers.cluster.local`` starts it, by ``python -m twinct.workers.cluster.head LIFELINE
REPORT SETTINGS``. The kernel kills Ray's processes, which belong to its group, with the parent.
"""

from __future__ import annotations

import json
import os
import signal
import sys

from twinct.workers.cluster.node import ray_module
from twinct.workers.lifeline import end_with


def main() -> None:
    """Start Ray, report its address, and wait to be killed."""
    end_with(int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    report = int(sys.argv[2])
    os.set_inheritable(report, False)
    context = ray_module().init(
        address="local",
        include_dashboard=False,
        log_to_driver=False,
        _node_ip_address="127.0.0.1",
        **json.loads(sys.argv[3]),
    )
    os.write(report, context.address_info["gcs_address"].encode())
    os.close(report)
    while True:
        signal.pause()


if __name__ == "__main__":
    main()
