"""Small files that unpack to far more than a memory, one for each format that is read."""

from __future__ import annotations

import gzip
import io
import json
import struct
import tarfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

WIDE = 30_000
"""Edge of the images: 3.6 GB in single precision, read into 29 GB of double precision."""

HUGE = 200_000
"""Edge of images in formats that state no more than a size: 320 GB in double precision."""

STREAM_BYTES = 2**31
"""Bytes of zeros in a stream that no header announces."""


def zeros(size: int = STREAM_BYTES, bits: int = zlib.MAX_WBITS) -> bytes:
    """Return a stream of deflate without its end, a thousandth of the zeros that it unpacks to."""
    pack = zlib.compressobj(9, zlib.DEFLATED, bits)
    start = pack.compress(bytes(2**20)) + pack.flush(zlib.Z_FULL_FLUSH)
    again = pack.compress(bytes(2**20)) + pack.flush(zlib.Z_FULL_FLUSH)
    return start + again * (size // 2**20 - 1)


def _described(folder: Path, images: str, **keys: Any) -> Path:
    """Return the description of a measured scan with these images."""
    circle = {"kind": "circle", "sod_mm": 200, "sdd_mm": 300, "pitch_mm": 2, "rotates": "object"}
    geometry = {**circle, "direction": "clockwise", "angles": {"step": 120}}
    stack = {"path": images, "values": "transmissions", **keys}
    (folder / "scan.yaml").write_text(json.dumps({"images": stack, "geometry": geometry}))
    return folder / "scan.yaml"


def zarr_chunk(folder: Path) -> Path:
    """One chunk of 30,000 x 30,000, of which Blosc needs 1 kB."""
    import zarr
    from zarr.codecs import BloscCodec

    array = zarr.create_array(
        str(folder / "a.zarr"), shape=(3, WIDE, WIDE), chunks=(1, WIDE, WIDE), dtype="f4",
        compressors=BloscCodec(),
    )  # fmt: skip
    (folder / "a.zarr" / "c" / "0" / "0").mkdir(parents=True)
    (folder / "a.zarr" / "c" / "0" / "0" / "0").write_bytes(bytes(1000))
    del array
    return _described(folder, "a.zarr")


def zarr_stream(folder: Path) -> Path:
    """A chunk of 16 x 16 pixels whose stream of gzip unpacks to 2 GiB."""
    import zarr
    from zarr.codecs import GzipCodec

    zarr.create_array(
        str(folder / "a.zarr"), shape=(3, 16, 16), chunks=(1, 16, 16), dtype="f4",
        compressors=GzipCodec(),
    )[:] = 1.0  # fmt: skip
    (folder / "a.zarr" / "c" / "1" / "0" / "0").write_bytes(zeros(bits=zlib.MAX_WBITS | 16))
    return _described(folder, "a.zarr")


def zarr_shard(folder: Path) -> Path:
    """A shard whose inner chunks state 2 GiB to Blosc, in place of 1 kB."""
    import zarr
    from zarr.codecs import BloscCodec

    zarr.create_array(
        str(folder / "a.zarr"),
        shape=(3, 16, 16),
        shards=(3, 16, 16),
        chunks=(1, 16, 16),
        dtype="f4",
        compressors=BloscCodec(),
    )[:] = 1.0
    file = folder / "a.zarr" / "c" / "0" / "0" / "0"
    data = bytearray(file.read_bytes())
    data[4:8] = struct.pack("<I", 2**31 - 17)
    file.write_bytes(data)
    return _described(folder, "a.zarr")


def hdf5_chunk(folder: Path) -> Path:
    """A dataset of 30,000 x 30,000 pixels that was never written."""
    import h5py

    with h5py.File(folder / "a.h5", "w") as file:
        file.create_dataset("a", (3, WIDE, WIDE), "f4", chunks=(1, WIDE, WIDE), compression="gzip")
    return _described(folder, "a.h5")


def hdf5_stream(folder: Path) -> Path:
    """A chunk of 16 x 16 pixels whose stream unpacks to 2 GiB."""
    import h5py

    with h5py.File(folder / "a.h5", "w") as file:
        data = file.create_dataset("a", (3, 16, 16), "f4", chunks=(1, 16, 16), compression="gzip")
        data[:] = 1.0
        data.id.write_direct_chunk((1, 0, 0), zeros())
    return _described(folder, "a.h5")


def npz(folder: Path) -> Path:
    """Arrays of 3.9 GB in 4 MB, as ``numpy.savez_compressed`` packs zeros."""
    shape = (3, 18_000, 18_000)
    head = io.BytesIO()
    told = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, told)
    size = len(head.getvalue()) + 4 * int(np.prod(shape))
    pack = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    data = pack.compress(head.getvalue()) + pack.flush(zlib.Z_FULL_FLUSH) + zeros(2**30, -15)
    name = b"a.npy"
    entry = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 33, 0, len(data), size, len(name), 0)
    local = b"PK\3\4" + entry + name + data
    central = (
        b"PK\1\2" + struct.pack("<H", 20) + entry + struct.pack("<HHHII", 0, 0, 0, 0, 0) + name
    )
    end = b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local), 0)
    (folder / "a.npz").write_bytes(local + central + end)
    return _described(folder, "a.npz")


def tiff_size(folder: Path) -> Path:
    """A page that states 200,000 x 200,000 pixels."""
    import tifffile

    tifffile.imwrite(folder / "a.tif", np.ones((16, 17), np.float32))
    data = (folder / "a.tif").read_bytes()
    for tag, old in ((256, 17), (257, 16)):
        entry = struct.pack("<HH", tag, 3) + struct.pack("<II", 1, old)
        assert entry in data or struct.pack("<HHII", tag, 4, 1, old) in data
        data = data.replace(entry, struct.pack("<HHII", tag, 4, 1, HUGE))
        data = data.replace(
            struct.pack("<HHII", tag, 4, 1, old), struct.pack("<HHII", tag, 4, 1, HUGE)
        )
    (folder / "a.tif").write_bytes(data)
    return _described(folder, "a.tif")


def tiff_stream(folder: Path) -> Path:
    """A page of 16 x 16 pixels whose strip unpacks to 2 GiB."""
    entries = {
        **{256: 16, 257: 16, 258: 32, 259: 8, 262: 1, 273: 0, 277: 1, 278: 16, 279: 0, 339: 3},
    }
    data, start = zeros(), 8 + 2 + 12 * len(entries) + 4
    entries |= {273: start, 279: len(data)}
    words = b"".join(
        struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(entries.items())
    )
    head = b"II*\0" + struct.pack("<IH", 8, len(entries))
    (folder / "a.tif").write_bytes(head + words + bytes(4) + data)
    return _described(folder, "a.tif")


def png(folder: Path) -> Path:
    """A header of 200,000 x 200,000 pixels, and no pixels."""

    def part(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", HUGE, HUGE, 8, 0, 0, 0, 0)
    whole = (
        b"\x89PNG\r\n\x1a\n"
        + part(b"IHDR", head)
        + part(b"IDAT", zeros(2**27))
        + part(b"IEND", b"")
    )
    (folder / "a.png").write_bytes(whole)
    return _described(folder, "a.png")


def write_dicom(folder: Path, syntax: str, pixels: bytes, size: int) -> bytes:
    """Write one grey image with these bytes as its pixels; return the file."""
    from pydicom.dataset import FileDataset, FileMetaDataset

    meta: Any = FileMetaDataset()
    meta.TransferSyntaxUID = syntax
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = (
        "1.2.840.10008.5.1.4.1.1.1",
        "1.2",
    )
    data: Any = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    data.Rows, data.Columns, data.SamplesPerPixel = size, size, 1
    data.PhotometricInterpretation, data.PixelRepresentation = "MONOCHROME2", 0
    data.BitsAllocated, data.BitsStored, data.HighBit = 8, 8, 7
    data.PixelData = pixels
    data["PixelData"].VR = "OB"
    data.save_as(folder / "a.dcm", enforce_file_format=True)
    return (folder / "a.dcm").read_bytes()


def dicom_frame(folder: Path) -> Path:
    """Frames of JPEG with 10,000 x 10,000 pixels in an image that states 65,535 x 65,535."""
    from PIL import Image
    from pydicom.encaps import encapsulate
    from pydicom.uid import JPEGBaseline8Bit

    stream = io.BytesIO()
    Image.new("L", (1000, 1000)).save(stream, "JPEG")
    write_dicom(folder, JPEGBaseline8Bit, encapsulate([stream.getvalue()]), 65_535)
    return _described(folder, "a.dcm")


def dicom_deflated(folder: Path) -> Path:
    """A data set that is one stream, which unpacks to 2 GiB."""
    from pydicom.uid import DeflatedExplicitVRLittleEndian

    whole = write_dicom(folder, DeflatedExplicitVRLittleEndian, bytes(256), 16)
    (folder / "a.dcm").write_bytes(whole[:300] + zeros(bits=-zlib.MAX_WBITS))
    return _described(folder, "a.dcm")


def metaimage(folder: Path) -> Path:
    """Compressed numbers of 6 GB in 2 MB."""
    data = zeros()
    head = f"ObjectType = Image\nNDims = 3\nDimSize = {WIDE} {WIDE} 3\nElementType = MET_USHORT\n"
    head += "BinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = True\n"
    head += f"CompressedDataSize = {len(data)}\nOffset = 0 0 0\nElementSpacing = 1 1 1\n"
    head += "TransformMatrix = 1 0 0 0 1 0 0 0 1\nElementDataFile = LOCAL\n"
    (folder / "a.mha").write_bytes(head.encode() + data)
    return _described(folder, "a.mha")


def mcap(folder: Path) -> Path:
    """A chunk of zstd of 1 GiB in 33 kB."""
    import zstandard

    packed = zstandard.compress(bytes(2**30))
    text = b"zstd"
    body = struct.pack("<QQQII", 0, 0, 2**30, 0, len(text)) + text
    body += struct.pack("<Q", len(packed)) + packed
    head = struct.pack("<BQII", 1, 8, 0, 0)  # no profile, no library
    magic = b"\x89MCAP0\r\n"
    (folder / "a.mcap").write_bytes(magic + head + struct.pack("<BQ", 6, len(body)) + body + magic)
    return folder / "a.mcap"


def json_text(folder: Path) -> Path:
    """Empty lists: 24 bytes in memory for each one of the file."""
    (folder / "a.json").write_text("[" + "[]," * 3_000_000 + "[]]")
    return folder / "a.json"


def rtk_xml(folder: Path) -> Path:
    """Entities that grow by ten, ten times: a billion laughs."""
    names = [f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "ha"}">' for k in range(10)]
    (folder / "a.xml").write_text(
        f"<?xml version='1.0'?><!DOCTYPE r [{''.join(names)}]><RTKThreeDCircularGeometry>"
        "<Projection><SourceToIsocenterDistance>&e9;</SourceToIsocenterDistance></Projection>"
        "</RTKThreeDCircularGeometry>"
    )
    np.save(folder / "a.npy", np.ones((3, 4, 4), np.float32))
    _described(folder, "a.npy")
    told = json.loads((folder / "scan.yaml").read_text())
    told["geometry"] = {"kind": "rtk", "path": "a.xml", "pitch_mm": 2}
    (folder / "scan.yaml").write_text(json.dumps(told))
    return folder / "scan.yaml"


def yaml_aliases(folder: Path) -> Path:
    """Lists of lists, each of nine times the one before."""
    lines = ["a0: &a0 [x]"] + [
        f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 30)
    ]
    (folder / "scan.yaml").write_text("\n".join(lines))
    return folder / "scan.yaml"


def arm_texture(folder: Path) -> Path:
    """A model of an arm with pictures of 21 GB in one line."""
    (folder / "arm.xml").write_text(
        f"<mujoco><asset><texture name='t' type='cube' builtin='flat' width='{WIDE}' "
        f"height='{6 * WIDE}'/></asset><worldbody><body name='b'/></worldbody></mujoco>"
    )
    return folder / "arm.xml"


def arm_copies(folder: Path) -> Path:
    """A model of an arm with a million times a million bodies."""
    (folder / "arm.xml").write_text(
        "<mujoco><worldbody><replicate count='1000000'><replicate count='1000000'>"
        "<body name='b'/></replicate></replicate></worldbody></mujoco>"
    )
    return folder / "arm.xml"


def nifti(folder: Path) -> Path:
    """Voxels of 54 GB in 50 MB of gzip at most; here in 2 MB."""
    import nibabel

    image: Any = nibabel.Nifti1Image(np.zeros((2, 3, 4), np.int16), np.eye(4))
    image.to_filename(folder / "v.nii")
    data = bytearray((folder / "v.nii").read_bytes()[:352])
    data[42:48] = struct.pack("<3h", 1000, 1000, 1000)
    (folder / "a.nii.gz").write_bytes(gzip.compress(bytes(data)) + zeros(bits=zlib.MAX_WBITS | 16))
    return folder / "a.nii.gz"


def invesalius(folder: Path) -> Path:
    """A project of 2 GiB in 2 MB of gzip."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        entry = tarfile.TarInfo("tmp/matrix.dat")
        entry.size = 0
        archive.addfile(entry, io.BytesIO(b""))
    head = gzip.compress(stream.getvalue()[:512])
    (folder / "a.inv3").write_bytes(head + zeros(bits=zlib.MAX_WBITS | 16))
    return folder / "a.inv3"


def ply(folder: Path) -> Path:
    """A header of four billion corners."""
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\n"
    (folder / "a.ply").write_text(f"{head}property float x\nend_header\n")
    return folder / "a.ply"


IMPORTED: tuple[Callable[[Path], Path], ...] = (
    *(
        zarr_chunk,
        zarr_stream,
        zarr_shard,
        hdf5_chunk,
        hdf5_stream,
        npz,
        tiff_size,
        tiff_stream,
        png,
    ),
    *(dicom_frame, dicom_deflated, metaimage, mcap, rtk_xml, yaml_aliases),
)
"""Those that ``twinct import`` reads."""

BODIES: tuple[Callable[[Path], Path], ...] = (nifti, invesalius, ply)
"""Those that a specimen names."""

ARMS: tuple[Callable[[Path], Path], ...] = (arm_texture, arm_copies)
"""Those that a scenario names as an arm."""
