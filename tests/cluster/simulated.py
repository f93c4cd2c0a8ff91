"""A cluster of two nodes on this machine, steered through stdin.

``python simulated.py FOLDER [BYTES]``: memory of each node, a GiB unless told. Says its address;
``remove`` kills the second node, ``add`` brings another one.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import ray
from ray.cluster_utils import Cluster

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    memory = int(sys.argv[2]) if len(sys.argv) > 2 else 2**30

    def node(name: str):
        cache = {"TWINCT_CACHE": str(folder / name)}
        return cluster.add_node(num_cpus=1, memory=memory, env_vars=cache)

    cluster = Cluster(shutdown_at_exit=False)
    node("first")
    second = node("second")
    print(cluster.address, flush=True)  # noqa: T201
    for line in sys.stdin:
        if line.strip() == "remove":
            cluster.remove_node(second, allow_graceful=False)
        if line.strip() == "add":
            second = node("second")
        print(line.strip(), flush=True)  # noqa: T201
    cluster.shutdown()
    ray.shutdown()
    os._exit(0)
