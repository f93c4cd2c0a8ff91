"""Work in other processes of this machine; ``twinct.workers.cluster`` uses several machines."""

from twinct.core.renamed import old_names
from twinct.workers.local import LocalPool
from twinct.workers.mapping import each, map_over
from twinct.workers.work import (
    Artifact,
    Died,
    Done,
    Event,
    Failed,
    Place,
    Pool,
    WithArtifacts,
    Work,
)

__all__ = [
    "Died",
    "Done",
    "Event",
    "Failed",
    "LocalPool",
    "WithArtifacts",
    "Artifact",
    "Place",
    "Pool",
    "Work",
    "each",
    "map_over",
]

__getattr__ = old_names(__name__, {"Made": "WithArtifacts", "Parcel": "Artifact"})
