"""Work in other processes of this machine; ``twinct.cluster`` uses several machines."""

from twinct.pool.local import LocalPool
from twinct.pool.mapping import each, map_over
from twinct.pool.work import Died, Done, Event, Failed, Made, Parcel, Place, Pool, Work

__all__ = [
    "Died",
    "Done",
    "Event",
    "Failed",
    "LocalPool",
    "Made",
    "Parcel",
    "Place",
    "Pool",
    "Work",
    "each",
    "map_over",
]
