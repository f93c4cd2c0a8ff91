"""Work done by other processes: of this machine here, of several in ``twinct.cluster``."""

from twinct.pool.work import Died, Done, Event, Failed, Made, Parcel, Place, Pool, Work

__all__ = ["Died", "Done", "Event", "Failed", "Made", "Parcel", "Place", "Pool", "Work"]
