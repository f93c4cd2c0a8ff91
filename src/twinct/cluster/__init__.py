"""Work done by several machines, by Ray: the only package that imports it."""

from twinct.cluster.pool import RayPool

__all__ = ["RayPool"]
