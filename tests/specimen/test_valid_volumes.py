"""Valid variants of CT volumes are read right: as made here, and as SimpleITK reads them."""

from __future__ import annotations

import gzip
import io
import plistlib
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ct_files import (
    LPS,
    Truth,
    as_jpeg2000,
    as_rle,
    assert_same,
    by_itk,
    frames,
    nifti,
    nifti_bytes,
    oblique,
    placed,
    save,
    slices,
)
from pydicom.uid import (
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    MediaStorageDirectoryStorage,
)

from twinct.specimen.volumes import read_ct

Make = Callable[[Path], tuple[Path, Truth]]

SAGITTAL = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]]).T @ np.diag([1, 1, 1])
CORONAL = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).T
PRONE = np.diag([-1.0, -1.0, 1.0])
HEAD_DOWN = np.diag([1.0, -1.0, -1.0])
TURNED = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]).T


def series(truth: Truth, change: Callable[[list[Any]], object] | None = None, **keys: Any) -> Make:
    """Single images; ``syntax`` and ``name`` go to ``save``."""
    saving = {key: keys.pop(key) for key in ("syntax", "name") if key in keys}

    def make(folder: Path) -> tuple[Path, Truth]:
        images = slices(truth, **keys)
        if change is not None:
            change(images)
        save(folder / "series", images, **saving)
        return folder / "series", truth

    return make


def enhanced(truth: Truth, change: Callable[[Any], object] | None = None, **keys: Any) -> Make:
    """Frames in one file."""
    saving = {key: keys.pop(key) for key in ("syntax",) if key in keys}

    def make(folder: Path) -> tuple[Path, Truth]:
        image = frames(truth, **keys)
        if change is not None:
            change(image)
        save(folder / "series", [image], **saving)
        return folder / "series", truth

    return make


def shuffled(seed: int) -> Callable[[list[Any]], object]:
    return lambda images: np.random.default_rng(seed).shuffle(images)  # type: ignore[arg-type]


def each(change: Callable[[Any], object]) -> Callable[[list[Any]], object]:
    return lambda images: [change(image) for image in images]


def put(**values: Any) -> Callable[[list[Any]], object]:
    def change(image: Any) -> None:
        for name, value in values.items():
            setattr(image, name, value)

    return each(change)


def without(*names: str) -> Callable[[list[Any]], object]:
    return each(lambda image: [delattr(image, name) for name in names])


def with_overlay(images: list[Any]) -> None:
    """Bits of an overlay in the unused high bits, as of old."""
    for image in images:
        pixels = np.frombuffer(image.PixelData, "<u2").copy()
        pixels[::3] |= 0x4000
        image.PixelData = pixels.tobytes()


def padded(stored: int, limit: int | None = None, told: int | None = None) -> Make:
    """The corners of each image are padding."""
    truth = placed()
    outside = np.zeros(truth.values.shape, dtype=bool)
    outside[-2:, -2:], outside[0, 0] = True, True
    truth = Truth(np.where(outside, -1000.0, truth.values), truth.affine, outside)

    def change(images: list[Any]) -> None:
        for k, image in enumerate(images):
            pixels = np.frombuffer(image.PixelData, "<i2").copy()
            pixels[outside[:, :, k].T.ravel()] = stored
            image.PixelData = pixels.tobytes()
            image.add_new("PixelPaddingValue", "SS" if told is None else "US", told or stored)
            if limit is not None:
                image.add_new("PixelPaddingRangeLimit", "SS", limit)

    return series(truth, change, kind="<i2", intercept=0.0)


def tilted(folder: Path) -> tuple[Path, Truth]:
    """A gantry tilted by 12 deg: images shifted along their columns; not for SimpleITK."""
    truth = placed()
    affine = truth.affine.copy()
    affine[:3, 2] += affine[:3, 1] / np.linalg.norm(affine[:3, 1]) * 1.5 * np.tan(np.radians(12))
    truth = replace(truth, affine=affine)
    images = slices(truth)
    put(GantryDetectorTilt=-12)(images)
    for k, image in enumerate(images):
        position = LPS[:3, :3] @ (affine[:3, 3] + k * affine[:3, 2])
        image.ImagePositionPatient = [f"{n:.6f}" for n in position]
    save(folder / "series", images)
    return folder / "series", truth


def among_others(folder: Path) -> tuple[Path, Truth]:
    path, truth = series(placed(), name="IM{:04d}")(folder)
    (path / "README").write_text("not an image")
    (path / ".DS_Store").write_bytes(b"\0\0\0\1Bud1")
    (path / "picture.jpg").write_bytes(b"\xff\xd8\xff\0")
    directory = slices(placed())[0]
    for name in ("PixelData", "Rows", "Columns"):
        delattr(directory, name)
    directory.SOPClassUID = MediaStorageDirectoryStorage
    save(folder / "directory", [directory], name="DICOMDIR")
    (folder / "directory" / "DICOMDIR").rename(path / "DICOMDIR")
    return path, truth


def volume(truth: Truth, packed: bool = False, unit: str = "mm", **keys: Any) -> Make:
    """One NIfTI file."""
    factor = {"mm": 1.0, "meter": 1e-3, "micron": 1e3, "unknown": 1.0}[unit]

    def make(folder: Path) -> tuple[Path, Truth]:
        scaled = np.diag([factor, factor, factor, 1.0]) @ truth.affine
        image = nifti(replace(truth, affine=scaled), **keys)
        image.header.set_xyzt_units(unit)
        data = bytes(nifti_bytes(image))
        path = folder / ("head.nii.gz" if packed else "head.nii")
        path.write_bytes(gzip.compress(data, mtime=0) if packed else data)
        return path, truth

    return make


def with_extension(folder: Path) -> tuple[Path, Truth]:
    path, truth = volume(placed())(folder)
    data = bytearray(path.read_bytes())
    data[348] = 1
    data[108:112] = np.float32(352 + 16).tobytes()
    path.write_bytes(data[:352] + np.array([16, 6], "<i4").tobytes() + b"comment\0" + data[352:])
    return path, truth


def with_a_fourth_axis(folder: Path) -> tuple[Path, Truth]:
    path, truth = volume(placed())(folder)
    data = bytearray(path.read_bytes())
    data[40:42] = np.int16(4).tobytes()
    path.write_bytes(data)
    return path, truth


def invesalius(packed: bool) -> Make:
    """A project with columns to the left, rows to the front and slices upwards."""

    def make(folder: Path) -> tuple[Path, Truth]:
        truth = Truth(placed().values, np.diag([-0.8, 1.0, 1.5, 1.0]))
        matrix = truth.values.transpose(2, 1, 0).astype("<i2")
        told = {"filename": "matrix.dat", "shape": list(matrix.shape), "dtype": "int16"}
        main = {"matrix": told, "spacing": [0.8, 1.0, 1.5], "modality": "CT"}
        path = folder / "head.inv3"
        with tarfile.open(path, "w:gz" if packed else "w") as archive:
            for name, content in (
                ("main.plist", plistlib.dumps(main)),
                ("matrix.dat", matrix.tobytes()),
            ):
                entry = tarfile.TarInfo(f"tmp/{name}")
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))
        return path, truth

    return make


BACKWARDS = list(range(10))[::-1]

VARIANTS: dict[str, Make] = {
    "axial": series(placed()),
    "sagittal": series(placed(SAGITTAL)),
    "coronal": series(placed(CORONAL)),
    "prone": series(placed(PRONE)),
    "head down": series(placed(HEAD_DOWN)),
    "turned in its plane": series(placed(TURNED)),
    **{f"oblique {seed}": series(placed(oblique(seed))) for seed in range(6)},
    "unsorted": series(placed(), shuffled(1)),
    "unsorted, oblique": series(placed(oblique(7)), shuffled(2)),
    "backwards": series(placed(), lambda images: images.reverse()),
    "fractional slope": series(placed(), slope=0.4883),
    "varying slopes": series(placed(), slope=lambda k: 0.3 + 0.07 * k),
    "varying slopes, signed": series(
        placed(), slope=lambda k: 0.5 / (k + 1), kind="<i2", intercept=24.5
    ),
    "large intercept": series(placed(), intercept=-8192.0),
    "signed": series(placed(), kind="<i2", intercept=0.0),
    "12 bits": series(placed(), stored=12),
    "13 bits, signed": series(placed(), kind="<i2", intercept=0.0, stored=13),
    "12 bits below an overlay": series(placed(), with_overlay, stored=12),
    "32 bits": series(placed(), kind="<u4"),
    "implicit": series(placed(), syntax=ImplicitVRLittleEndian),
    "big-endian": series(placed(), syntax=ExplicitVRBigEndian),
    "big-endian, oblique, signed": series(
        placed(oblique(8)), kind="<i2", intercept=0.0, syntax=ExplicitVRBigEndian
    ),
    "run lengths": series(placed(), each(as_rle)),
    "run lengths, signed": series(placed(), each(as_rle), kind="<i2", intercept=0.0),
    "JPEG 2000": series(placed(), each(as_jpeg2000)),
    "JPEG 2000, oblique, fractional": series(placed(oblique(9)), each(as_jpeg2000), slope=0.61),
    "named .dcm": series(placed(), name="{:d}.dcm"),
    "named .IMA": series(placed(), name="1.2.3.{:04d}.IMA"),
    "named by identifiers": series(placed(), name="1.2.840.{:d}"),
    "among other files": among_others,
    "without RescaleType": series(placed(), without("RescaleType")),
    "small voxels": series(placed(None, (0.031, 0.031, 0.05))),
    "padding": padded(-2000),
    "padding of bone": padded(3000),
    "padding stated as unsigned": padded(-2000, told=63536),
    "padding range": padded(-1500, limit=-2000),
    "tilted gantry": tilted,
    "frames": enhanced(placed()),
    "frames, oblique": enhanced(placed(oblique(10))),
    "frames, backwards": enhanced(placed(), order=BACKWARDS),
    "frames, shared slope": enhanced(placed(), slope=0.5, shared_slope=True),
    "frames, varying slopes": enhanced(placed(), slope=lambda k: 0.5 + 0.05 * k),
    "frames, run lengths": enhanced(placed(), as_rle),
    "frames, JPEG 2000": enhanced(placed(), as_jpeg2000),
    "frames, big-endian": enhanced(placed(), syntax=ExplicitVRBigEndian),
    "NIfTI": volume(placed()),
    "NIfTI, packed": volume(placed(), packed=True),
    "NIfTI, sagittal": volume(placed(SAGITTAL)),
    "NIfTI, left-handed": volume(placed(np.diag([-1.0, 1.0, 1.0]))),
    **{f"NIfTI, oblique {n}": volume(placed(oblique(n)), codes=(1, 1)) for n in (11, 12)},
    "NIfTI, qform": volume(placed(oblique(13)), codes=(0, 1)),
    "NIfTI, qform, left-handed": volume(placed(np.diag([1.0, 1.0, -1.0])), codes=(0, 1)),
    "NIfTI, scaled": volume(placed(), kind="<u2", slope=0.37, inter=-1024.0),
    "NIfTI, scaled, packed": volume(placed(), True, kind="<i4", slope=0.001, inter=0.5),
    "NIfTI, big-endian": volume(placed(), kind=">i2"),
    "NIfTI, big-endian, floats": volume(placed(oblique(14)), True, kind=">f4"),
    "NIfTI, double": volume(placed(), kind="<f8"),
    "NIfTI, 64 bits": volume(placed(), kind="<i8"),
    "NIfTI 2": volume(placed(), version=2),
    "NIfTI 2, packed, big-endian": volume(placed(), True, kind=">i2", version=2),
    "NIfTI, metres": volume(placed(), unit="meter"),
    "NIfTI, micrometres": volume(placed(), unit="micron"),
    "NIfTI, unknown unit": volume(placed(), unit="unknown"),
    "NIfTI, extension": with_extension,
    "NIfTI, one of a fourth axis": with_a_fourth_axis,
    "InVesalius": invesalius(packed=False),
    "InVesalius, packed": invesalius(packed=True),
}

NOT_BY_ITK = {
    "tilted gantry": "it takes slices to be at right angles",
    "frames, varying slopes": "it takes one slope for all frames",
    "NIfTI 2": "it knows version 1",
    "NIfTI 2, packed, big-endian": "it knows version 1",
    "InVesalius": "it does not know the format",
    "InVesalius, packed": "it does not know the format",
}


QUICK = set(list(VARIANTS)[::4])
"""Variants that make test reads; make test-all reads all."""


@pytest.mark.parametrize(
    "name",
    [n if n in QUICK else pytest.param(n, marks=pytest.mark.tutorial) for n in VARIANTS],
)
def test_valid_variants_are_read_right(tmp_path: Path, name: str) -> None:
    path, truth = VARIANTS[name](tmp_path)
    image = read_ct(path, "it")
    assert_same(image, truth)
    if name not in NOT_BY_ITK:
        other = by_itk(path)
        ours = np.where(truth.uncompared, 0, image.values) if truth.uncompared is not None else None
        if ours is not None:
            other = replace(other, values=np.where(truth.uncompared, 0, other.values))
            image = replace(image, values=ours)
        assert_same(image, other, 0.01)


def test_sixty_variants_and_more() -> None:
    assert len(VARIANTS) - len(NOT_BY_ITK) >= 60
    assert set(NOT_BY_ITK) <= set(VARIANTS)
