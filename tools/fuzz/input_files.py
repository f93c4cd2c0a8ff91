"""Fuzzing of the files that scenarios name: each must give finite values or be refused."""

from __future__ import annotations

import gzip
import os
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cases import Case
from mutations import NASTY_TEXTS, broken
from valid_files import chains, write_all

from twinct.core.files.images import RawImage, read_image
from twinct.core.files.tables import read_curve
from twinct.ctsimu.scenario import load_ctsimu
from twinct.geometry import Panel
from twinct.recon.volume import Volume
from twinct.robots.calibrated_arms import CalibratedArms
from twinct.robots.cell.own_arms import read_own_arm
from twinct.robots.motion import load_plan
from twinct.scenario import CtVolume, DetectorArm, MeshFile
from twinct.specimen.shapes import shape_surface
from twinct.trajectory import commanded_views
from twinct.trajectory.table import FileTrajectory

SPECIAL = 0.04
"""Share of cases that replace the file with a pipe, device, folder, link or nothing."""


def _mesh(path: Path) -> Any:
    return shape_surface(MeshFile(kind="mesh", path=path), "body").vertices


def _ct(path: Path) -> Any:
    return shape_surface(CtVolume(kind="ct", path=path, smallest_part_cm3=0), "body").vertices


def _views(path: Path) -> Any:
    views = commanded_views(FileTrajectory(kind="file", path=path), Panel(16, 16, 1.0, 1.0))
    return np.stack([views.source, views.detector, views.u, views.v])


def _image(path: Path) -> Any:
    file = RawImage(path, "<f4", 16, 12, 0) if path.suffix == ".raw" else path
    read_image(file, "bad pixels", (12, 16))  # pixels that are not finite are allowed
    return np.zeros(1)


def _arms(path: Path) -> Any:
    return np.concatenate([change.links for change in CalibratedArms.read(path, chains()).changes])


def _arm(path: Path) -> Any:
    section = DetectorArm.model_validate({"file": str(path), "flange": "l5"})
    return read_own_arm(section, "cell.detector_arm.file").file_from_base.matrix


def _ctsimu(path: Path) -> Any:
    return load_ctsimu(path).frame(0).panel.size_mm


READERS: dict[str, Callable[[Path], Any]] = {
    **dict.fromkeys(
        ("body.stl", "text.stl", "body.ply", "text.ply", "body.obj", "body.off"), _mesh
    ),
    **dict.fromkeys(("head.nii", "head.nii.gz", "head.inv3", "plain.inv3", "dicom"), _ct),
    **dict.fromkeys(("image.npy", "image.png", "image.bmp", "image.tif"), _image),
    **dict.fromkeys(("packed.tif", "image.raw"), _image),
    **{"views.csv": _views, "curve.txt": read_curve, "arms.json": _arms, "arm.xml": _arm},
    **{"plan.npz": lambda path: load_plan(path).state, "small.json": _ctsimu, "drift.csv": _ctsimu},
    "volume.nii": lambda path: Volume.read(path).grid.affine,
}


class Kind:
    """Files of each kind, damaged in many ways and read as a scenario reads them."""

    seconds = 30.0
    memory_bytes = 2 * 2**30

    def __init__(self, material: Path) -> None:
        """Write valid files, and check that all can be read."""
        shutil.rmtree(material)
        material.mkdir()
        write_all(material)
        shutil.copy(material / "head.nii", material / "volume.nii")
        self._material = material
        for name, read in READERS.items():
            read(material / ("small.json" if name == "drift.csv" else name))

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case with one damaged file, beside the files that it needs."""
        name = rng.choice(list(READERS))
        for file in self._material.iterdir():
            if file.is_file() and name in ("small.json", "drift.csv"):
                shutil.copy(file, folder)
        if name == "dicom":
            shutil.copytree(self._material / name, folder / name)
            target = rng.choice(sorted((folder / name).iterdir()))
        else:
            shutil.copy(self._material / name, folder)
            target = folder / name
        told = special(rng, target) if rng.random() < SPECIAL else damaged(rng, target)
        path = folder / ("small.json" if name == "drift.csv" else name)
        return Case(f"{target.name}: {told}", lambda: _finite(READERS[name], path))


def _finite(read: Callable[[Path], Any], path: Path) -> str:
    if not np.isfinite(np.asarray(read(path), dtype=float)).all():
        raise AssertionError("a number that is not finite was accepted")
    return "read"


def special(rng: random.Random, path: Path) -> str:
    """Replace a file by something that is none; return a description of it."""
    path.unlink()
    match rng.choice(("pipe", "zero", "folder", "loop", "nothing", "empty", "memory", "secret")):
        case "pipe":
            os.mkfifo(path)
            return "a pipe"
        case "zero":
            path.symlink_to("/dev/zero")
            return "/dev/zero"
        case "folder":
            path.mkdir()
            return "a folder"
        case "loop":
            path.symlink_to(path)
            return "a link to itself"
        case "empty":
            path.touch()
            return "empty"
        case "memory":
            path.symlink_to("/proc/self/mem")
            return "/proc/self/mem"
        case "secret":
            path.touch(mode=0)
            return "not to be read"
        case _:
            return "nothing"


def damaged(rng: random.Random, path: Path) -> str:
    """Damage the content of a file; return a description of it."""
    data = path.read_bytes()
    packed = data[:2] == b"\x1f\x8b" and rng.random() < 0.6
    if packed:  # damage the content, not the compression
        data = gzip.decompress(data)
    is_text = b"\0" not in data
    if is_text and rng.random() < 0.7:
        data, told = _other_words(rng, data)
    elif rng.random() < 0.35:  # a false number in the header
        at = rng.randrange(min(len(data), 400))
        number = rng.choice((0, 1, -1, 2**31 - 1, 2**16 - 1, 2**63 - 1, rng.randrange(2**31)))
        size = rng.choice((1, 2, 4, 8))
        new = (number % 2 ** (8 * size)).to_bytes(size, rng.choice(("little", "big")))
        data, told = data[:at] + new + data[at + size :], f"{number} of {size} bytes over {at}"
    else:
        data, told = broken(rng, data)
    path.write_bytes(gzip.compress(data, mtime=0) if packed else data)
    return told


def _other_words(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Return text with some changed words and numbers, and a description of the changes."""
    told: list[str] = []
    for _ in range(rng.choice((1, 1, 2, 4))):
        words = list(re.finditer(rb"[-+.\w]+", data))
        if not words:
            break
        word = rng.choice(words)
        numbers = (
            "nan",
            "inf",
            "-1",
            "0",
            "1e308",
            "1e-320",
            "999999999999",
            "4294967296",
            "1.5",
            "",
        )
        new = rng.choice((*numbers, *numbers, *NASTY_TEXTS))
        data = data[: word.start()] + new.encode() + data[word.end() :]
        told.append(f"{word[0][:20]!r} becomes {new[:20]!r}")
    if rng.random() < 0.05:
        data *= rng.choice((2, 100, 20_000))
        told.append("again and again")
    return data, ", ".join(told)
