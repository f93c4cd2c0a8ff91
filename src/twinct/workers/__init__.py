"""Work in other processes of this machine; ``twinct.workers.cluster`` uses several machines."""

from twinct.workers.local import LocalPool
from twinct.workers.pool import Pool
from twinct.workers.work import Died, Done, Event, Failed, Place, Work

__all__ = ["Died", "Done", "Event", "Failed", "LocalPool", "Place", "Pool", "Work"]
