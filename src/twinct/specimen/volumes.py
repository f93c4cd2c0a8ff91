"""CT volumes: read, segment at a threshold, closed surface."""

from __future__ import annotations

import trimesh

from twinct import scenario


def ct_surface(shape: scenario.CtVolume, name: str) -> trimesh.Trimesh:
    """Soon."""
    raise NotImplementedError
