"""Work in other processes of this machine; ``twinct.workers.cluster`` uses several machines."""

from twinct.workers.local import LocalPool
from twinct.workers.mapping import map_over
from twinct.workers.work import (
    Artifact,
    Died,
    Done,
    Event,
    Failed,
    Place,
    Pool,
    Work,
)

__all__ = [
    "Died",
    "Done",
    "Event",
    "Failed",
    "LocalPool",
    "Artifact",
    "Place",
    "Pool",
    "Work",
    "map_over",
]
