"""A stack of projections on disk, written image by image, so that memory holds only one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from twinct.exchange.format import Bundle


def write_npy(path: Path, bundle: Bundle) -> None:
    """Write images as one NumPy array (view, row, column), float32."""
    shape = (len(bundle.geometry), *bundle.geometry.panel.shape)
    with path.open("wb") as stream:
        np.lib.format.write_array_header_1_0(
            stream, {"descr": "<f4", "fortran_order": False, "shape": shape}
        )
        for image in bundle.images:
            stream.write(np.ascontiguousarray(image, "<f4").tobytes())


def write_raw(folder: Path, bundle: Bundle, names: Iterable[str]) -> None:
    """Write one file of raw float32 values per image, the image's last row first."""
    folder.mkdir()
    for name, image in zip(names, bundle.images, strict=True):
        (folder / name).write_bytes(np.ascontiguousarray(image[::-1], "<f4").tobytes())


def write_mha(path: Path, bundle: Bundle) -> None:
    """Write images as one MetaImage stack (column, row, view), centred on the panel, mm.

    The format is ITK's: a text header with ``ElementDataFile`` as its last line, then the raw
    values.
    """
    panel = bundle.geometry.panel
    origin = panel.first_pixel_mm
    header = {
        "ObjectType": "Image",
        "NDims": "3",
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": "False",
        "TransformMatrix": "1 0 0 0 1 0 0 0 1",
        "Offset": f"{origin[0]!r} {origin[1]!r} 0",
        "CenterOfRotation": "0 0 0",
        "ElementSpacing": f"{panel.pitch_u!r} {panel.pitch_v!r} 1",
        "DimSize": f"{panel.columns} {panel.rows} {len(bundle.geometry)}",
        "ElementType": "MET_FLOAT",
        "ElementDataFile": "LOCAL",
    }
    with path.open("wb") as stream:
        stream.write("".join(f"{key} = {value}\n" for key, value in header.items()).encode())
        for image in bundle.images:
            stream.write(np.ascontiguousarray(image, "<f4").tobytes())
