"""Closed surfaces from STL, PLY and OBJ files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from twinct.errors import SpecimenError

_KNOWN = "STL, PLY and OBJ files are known"


def read_triangles(path: Path, where: str) -> trimesh.Trimesh:
    """The triangles of an STL, PLY or OBJ file, in its own unit; messages call it ``where``.

    Raises:
        SpecimenError: the file cannot be read, or holds no triangles of finite corners.
    """
    if path.is_dir():
        raise SpecimenError(f"{where} is a folder; the name of one file is needed")
    if not path.is_file():
        raise SpecimenError(f"{where} does not exist")
    try:
        mesh = trimesh.load(path, force="mesh")
    except ImportError:  # trimesh looks for a guesser of encodings where text is none it knows
        raise SpecimenError(f"{where} is no mesh: {_KNOWN}") from None
    except Exception as error:  # trimesh's readers raise whatever their format brings
        why = f"{type(error).__name__}: {error}"
        raise SpecimenError(f"{where} cannot be read ({why}); {_KNOWN}") from None
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise SpecimenError(f"{where} holds no triangles")
    if not np.isfinite(mesh.vertices).all():
        raise SpecimenError(f"{where} holds vertices that are not finite")
    return mesh


def read_mesh(path: Path, where: str) -> trimesh.Trimesh:
    """The closed surface that a file holds, in its own unit, mended where that is trivial.

    Equal vertices are merged, collapsed and repeated triangles dropped, normals turned outwards.

    Raises:
        SpecimenError: as ``read_triangles``, or the surface is open, or has no inside.
    """
    mesh = _mended(read_triangles(path, where))
    if not mesh.is_watertight:
        raise SpecimenError(
            f"{where} is open: {open_edges(mesh)} of {len(mesh.edges_unique)} edges do not join "
            "exactly two triangles. X-ray path lengths need a closed surface; close it in a "
            "mesh editor"
        )
    if not mesh.is_winding_consistent or not mesh.volume > 0:
        raise SpecimenError(f"{where} has triangles whose inside and outside cannot be told apart")
    return mesh


def open_edges(mesh: trimesh.Trimesh) -> int:
    """Number of edges that do not join exactly two triangles."""
    _, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return int((counts != 2).sum())


def _mended(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=0.0))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if mesh.is_watertight:
        if not mesh.is_winding_consistent:
            trimesh.repair.fix_winding(mesh)
        if mesh.volume < 0:
            mesh.invert()
    return mesh
