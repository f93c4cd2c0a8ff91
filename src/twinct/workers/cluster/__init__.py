"""Work on several machines by Ray; no other package imports Ray."""

from twinct.workers.cluster.pool import RayPool

__all__ = ["RayPool"]
