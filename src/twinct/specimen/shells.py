"""One solid from the shells of a mesh: overlaps count once."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import manifold3d
import numpy as np

from twinct.core.errors import SpecimenError
from twinct.specimen.surface import from_manifold, surface, to_manifold

if TYPE_CHECKING:
    import trimesh

log = logging.getLogger(__name__)

TOUCH = 1e-7
"""Overlap below this share of the volume is the rounding of touching shells in single precision."""


def joined_shells(mesh: trimesh.Trimesh, where: str) -> trimesh.Trimesh:
    """Return the solid that the shells of a mesh form together.

    Shells with outward normals are bodies and are united; shells with inward normals are cavities
    of the smallest body around them. A mesh whose shells do not meet is returned unchanged.
    Messages start with ``where``.

    Raises:
        SpecimenError: an inward shell lies in no other shell or crosses one, or a shell is not a
            solid.
    """
    shells = _shells(mesh)
    if len(shells) == 1:
        return mesh
    bodies = [_solid(shell, where) for shell in shells if shell.volume > 0]
    turned = [surface(s.vertices, s.faces[:, ::-1]) for s in shells if not s.volume > 0]
    cavities = [_solid(shell, where) for shell in turned]
    least = TOUCH * float(sum(body.volume() for body in bodies))
    whole, holes = _sum(bodies), _sum(cavities)
    once, excess = float(mesh.volume), sum(c.volume() for c in cavities) - holes.volume()
    if abs((whole - holes).volume() - once) < least and abs(excess) < least:
        return mesh
    for cavity in cavities:
        _carve(bodies, cavity, least, where)
    solid = _sum(bodies)
    twice = once - solid.volume()
    if twice < least:  # bodies within cavities of others
        return mesh
    message = "%s: its %d shells overlap; the shared volume (%.3g mm^3 in all) counts once"
    log.warning(message, where, len(shells), twice)
    return from_manifold(solid)


def _shells(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    import trimesh

    labels = trimesh.graph.connected_component_labels(
        mesh.face_adjacency, node_count=len(mesh.faces)
    )
    order = np.argsort(labels, kind="stable")
    shells = []
    for faces in np.split(order, np.cumsum(np.bincount(labels))[:-1]):
        corners, local = np.unique(mesh.faces[faces], return_inverse=True)
        shells.append(surface(mesh.vertices[corners], local.reshape(-1, 3)))
    return shells


def _solid(shell: trimesh.Trimesh, where: str) -> manifold3d.Manifold:
    solid = to_manifold(shell)
    if solid.is_empty():
        raise SpecimenError(
            f"{where} has several shells, and the one {_at(shell.bounds)} is not a solid, so "
            "its overlap with the others cannot be checked"
        )
    return solid


def _sum(solids: list[manifold3d.Manifold]) -> manifold3d.Manifold:
    return manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)


def _carve(
    bodies: list[manifold3d.Manifold], cavity: manifold3d.Manifold, least: float, where: str
) -> None:
    """Cut a cavity out of the smallest body around it."""
    for i in sorted(range(len(bodies)), key=lambda i: bodies[i].volume()):
        if (cavity - bodies[i]).volume() < least < (cavity ^ bodies[i]).volume():
            bodies[i] = bodies[i] - cavity
            return
    place = _at(np.reshape(cavity.bounding_box(), (2, 3)))
    raise SpecimenError(
        f"{where}: the shell {place} is turned inside out like a cavity, but "
        "does not lie within another shell; flip or move it in a mesh editor"
    )


def _at(bounds: np.ndarray) -> str:
    x, y, z = bounds.mean(axis=0)
    return f"around ({x:.3g}, {y:.3g}, {z:.3g}) mm"
