"""Volumes as MetaImage files, in ITK's axes: left, posterior, superior.

Format: https://itk.org/Wiki/ITK/MetaIO/Documentation. The rows of ``TransformMatrix`` are the
directions of the file's axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from twinct.geometry import VolumeGrid
from twinct.recon.volume_formats.volume_format import (
    LPS_FROM_RAS,
    Singles,
    VolumeFacts,
    VolumeFormat,
    frame,
)


def _write(array: Singles, grid: VolumeGrid, path: Path, facts: VolumeFacts) -> None:
    axes, edges, origin = frame(LPS_FROM_RAS @ grid.affine)
    header = {
        "ObjectType": "Image",
        "NDims": "3",
        "Comment": " ".join(f"{facts.note} ({facts.unit})".split()),
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        "TransformMatrix": _listed(axes.T.ravel()),
        "Offset": _listed(origin),
        "CenterOfRotation": "0 0 0",
        "ElementSpacing": _listed(edges),
        "DimSize": _listed(grid.shape_xyz),
        "ElementType": "MET_FLOAT",
        "ElementDataFile": "LOCAL",
    }
    with path.open("wb") as stream:
        stream.write("".join(f"{key} = {value}\n" for key, value in header.items()).encode())
        for plane in array:
            stream.write(plane.astype("<f4").tobytes())


def _listed(numbers: Iterable[float]) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)


METAIMAGE = VolumeFormat("metaimage", "MetaImage of ITK", (".mha",), _write)
