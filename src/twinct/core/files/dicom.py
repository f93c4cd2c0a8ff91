"""DICOM files: bounded before they are unpacked."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError
from twinct.core.files.packed import require_unpacked

DEFLATED = "is deflated; unpack the series, e.g. with dcmconv +te from dcmtk"
"""What messages say about a file in which nothing limits what it unpacks to."""


def is_deflated(path: Path) -> bool:
    """Return True if all of a file behind its first group is one stream of deflate."""
    from pydicom.filereader import read_file_meta_info
    from pydicom.uid import DeflatedExplicitVRLittleEndian

    meta = read_file_meta_info(path)
    return str(meta.get("TransferSyntaxUID", "")) == DeflatedExplicitVRLittleEndian


def require_frame(
    data: Any, index: int, packed: int, where: str, kind: type[InputError] = InputError
) -> None:
    """Check that a frame is as large as its header states, and fits into the memory.

    Decoders of JPEG follow the size in the frame's own header.

    Args:
        data: data set with pixels.
        index: number of the frame.
        packed: bytes of the file.
        where: beginning of messages.
        kind: type of the error.

    Raises:
        InputError: of this ``kind``; the frame states another size, or is too large.
    """
    from PIL import Image
    from pydicom.encaps import get_frame
    from pydicom.uid import JPEG2000TransferSyntaxes, JPEGTransferSyntaxes

    rows, columns, bits = (int(data[name].value) for name in ("Rows", "Columns", "BitsAllocated"))
    require_unpacked(packed, rows * columns * max(bits, 8) // 8, where, kind, copies=3)
    syntax = data.file_meta.TransferSyntaxUID
    if syntax not in (*JPEG2000TransferSyntaxes, *JPEGTransferSyntaxes):
        return
    frames = int(data.get("NumberOfFrames", 1) or 1)
    try:
        frame = get_frame(data.PixelData, index, number_of_frames=frames)
        with Image.open(BytesIO(frame)) as picture:
            size = picture.size
    except Exception:  # of any kind: the decoder opens frames in this way, and fails as well
        return
    if size != (columns, rows):
        raise kind(
            f"{where}: frame {index} has {size[1]} x {size[0]} pixels; its header states "
            f"{rows} x {columns}"
        )
