"""Closed surfaces from STL, PLY, OBJ and OFF files."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import SpecimenError
from twinct.core.files.boundary import no_file, read_bytes, require_memory
from twinct.core.foreign_text import shortened, whole_number

if TYPE_CHECKING:
    import trimesh

_KNOWN = "STL, PLY, OBJ or OFF"
_KINDS = ("stl", "ply", "obj", "off")

_NO_NUMBER = re.compile(rb"^[^#\n]*[^\0-\x7f#\n]|^[^#\n]*_", re.MULTILINE)
"""Digits of other scripts, and underscores, outside of comments: trimesh reads them with float."""
_MATERIAL = re.compile(rb"^[ \t]*(?:usemtl|mtllib)\b[^\r\n]*", re.MULTILINE)
_NEXT_SOLID = re.compile(
    rb"^[ \t]*endsolid\b[^\r\n]*\s*^[ \t]*solid\b[^\r\n]*", re.MULTILINE | re.IGNORECASE
)

LARGEST_BYTES = 2**30
"""Largest file: 20 million triangles of binary STL."""

MEMORY_FACTOR = 8
"""Bytes in memory per byte of a file while it is read; text formats need fewer."""


def read_triangles(path: Path, where: str) -> trimesh.Trimesh:
    """Read the triangles of an STL, PLY, OBJ or OFF file in its unit; messages call it ``where``.

    Raises:
        SpecimenError: the file cannot be read, or holds no triangles with finite corners.
    """
    import trimesh

    if why := no_file(path):
        raise SpecimenError(f"{where} {why}")
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _KINDS:
        raise SpecimenError(f"{where} is not a mesh file; expected {_KNOWN}")
    data = read_bytes(path, where, LARGEST_BYTES, SpecimenError)
    require_memory(where, MEMORY_FACTOR * len(data), SpecimenError)
    mesh = _loaded(_prepared(data, kind, where), kind, where)
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise SpecimenError(f"{where} holds no triangles")
    if mesh.vertices.shape[1:] != (3,):
        raise SpecimenError(f"{where} holds vertices that have not three coordinates")
    if not np.isfinite(mesh.vertices).all():
        raise SpecimenError(f"{where} holds vertices that are not finite")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise SpecimenError(f"{where} holds triangles whose corners do not exist")
    return mesh.process()


def _prepared(data: bytes, kind: str, where: str) -> bytes:
    """Return the content of a file in the form that trimesh reads fast and right.

    Left out is what divides its triangles, materials of OBJ and solids of text STL: trimesh makes a
    mesh of each piece and then joins them, in a time that grows with their square.

    Raises:
        SpecimenError: the content is none that trimesh may read.
    """
    if kind == "ply":
        _check_ply(data, where)
    elif kind == "off" and _NO_NUMBER.search(data):
        raise SpecimenError(f"{where} holds a word that is no number")
    elif kind == "obj":
        return _MATERIAL.sub(b"", data)
    elif kind == "stl" and len(data) != 84 + 50 * int.from_bytes(data[80:84], "little"):  # as text
        return _NEXT_SOLID.sub(b"", data)
    return data


def _loaded(data: bytes, kind: str, where: str) -> Any:
    import trimesh

    try:
        with warnings.catch_warnings():
            # numpy only warns where it ends at a word that is no number.
            warnings.filterwarnings("error", "string or file could not be read to its end")
            # From memory and without materials, so that nothing looks for other files.
            return trimesh.load(
                io.BytesIO(data), file_type=kind, force="mesh", process=False, skip_materials=True
            )
    except ImportError:  # trimesh asks for an encoding detector if text is in no encoding it knows
        raise SpecimenError(f"{where} is not a mesh file; expected {_KNOWN}") from None
    except Exception as error:  # trimesh's readers raise any exception
        why = shortened(f"{type(error).__name__}: {error}")
        raise SpecimenError(f"{where} cannot be read ({why}); expected {_KNOWN}") from None


def write_ply(path: Path, vertices: ArrayLike, faces: ArrayLike) -> None:
    """Write triangles as binary PLY: equal ones give equal bytes, and are read to equal numbers.

    Args:
        path: path of the file.
        vertices: corners, (n, 3), float64.
        faces: indices of each triangle's corners, (m, 3).
    """
    corners = np.asarray(vertices, dtype="<f8")
    triangles = np.empty(len(np.asarray(faces)), dtype=[("corners", "u1"), ("indices", "<i4", 3)])
    triangles["corners"], triangles["indices"] = 3, faces
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(corners)}\n{axes}"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + corners.tobytes() + triangles.tobytes())


def _check_ply(data: bytes, where: str) -> None:
    """Refuse a PLY header that states more elements than the file has bytes."""
    header = data[: max(data.find(b"end_header"), 0)]
    for number in re.findall(rb"^element\s+\S+\s+(\S+)", header, re.MULTILINE):
        stated = number.decode("latin-1")
        if (elements := whole_number(stated)) is None or elements > len(data):
            stated = shortened(stated, 30)
            raise SpecimenError(f"{where} is cut off: its header states {stated} elements")


def read_mesh(path: Path, where: str) -> trimesh.Trimesh:
    """Read the closed surface in a file, in its own unit, with trivial repairs.

    Equal vertices are merged, collapsed and repeated triangles dropped, and normals turned
    outwards.

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
        raise SpecimenError(f"{where} has triangles whose inside and outside are not clear")
    return mesh


def open_edges(mesh: trimesh.Trimesh) -> int:
    """Return the number of edges that do not join exactly two triangles."""
    _, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return int((counts != 2).sum())


def _mended(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    import trimesh

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
