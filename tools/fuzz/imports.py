"""Fuzzing of imports: each measured scan must give finite transmissions or be refused."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pydicom
import tifffile
import zarr
from cases import Case
from input_files import SPECIAL, damaged, special
from valid_files import write_ctsimu, write_dicom, write_meshes

from twinct.ctsimu import Options, load_ctsimu, render
from twinct.exchange import Bundle, formats, write_bundle
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.measured import description_of, import_measured, importing
from twinct.scan import ScanStore

VIEWS, PANEL = 6, Panel(12, 16, 2.0, 2.0)
SOD, SDD = 200.0, 300.0

XTEKCT = f"""[XTekCT]
Name=nut
Projections={VIEWS}
DetectorPixelsX={PANEL.columns}
DetectorPixelsY={PANEL.rows}
DetectorPixelSizeX=2
DetectorPixelSizeY=2
SrcToObject={SOD}
SrcToDetector={SDD}
InitialAngle=0
AngularStep={360 / VIEWS}
WhiteLevel=50000
ObjectOffsetX=0.7
"""
CIRCLE = {
    "kind": "circle", "sod_mm": SOD, "sdd_mm": SDD, "pitch_mm": 2.0, "rotates": "object",
    "direction": "clockwise",
}  # fmt: skip


class Kind:
    """Measured scans of each source, with one file damaged, imported into a new folder."""

    seconds = 30.0
    memory_bytes = 2 * 2**30

    def __init__(self, material: Path) -> None:
        """Write valid sources, and check that all can be imported."""
        shutil.rmtree(material)
        material.mkdir()
        importing.show = lambda *_: None  # pictures take longer than all else
        self._material, self._sources = material, _sources(material)
        for source in self._sources:
            _imported(material / source, material / "out")
            shutil.rmtree(material / "out")

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case: a source in a folder of its own, with one damaged file."""
        source = rng.choice(self._sources)
        place = Path(source).parts[0]
        shutil.copytree(self._material / place, folder / place)
        words = [folder / source, folder / source] if (folder / source).is_file() else []
        files = sorted(p for p in (folder / place).rglob("*") if p.is_file())
        texts = [p for p in files if p.suffix in (".json", ".xml", ".yaml", ".csv", ".xtekct")]
        target = rng.choice([*words, *texts, rng.choice(files)])
        told = special(rng, target) if rng.random() < SPECIAL else damaged(rng, target)
        name = target.relative_to(folder)
        return Case(f"{source}, {name}: {told}", lambda: _imported(folder / source, folder / "out"))


def _imported(source: Path, out: Path) -> str:
    import_measured(description_of(source), out)
    if not np.isfinite(ScanStore(out / "scan.zarr").read().transmission).all():
        raise AssertionError("a number that is not finite was accepted")
    return "imported"


def _sources(material: Path) -> list[str]:
    """Write a source of each kind; return the paths of all below the folder."""
    found: list[str] = []
    rng = np.random.default_rng(5)
    images = rng.uniform(0.1, 0.9, (VIEWS, *PANEL.shape)).astype(np.float32)
    angle = np.radians(np.arange(VIEWS) * 360 / VIEWS)
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    right = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (VIEWS, 1))
    views = ScanGeometry(SOD * out, (SOD - SDD) * out, right, up, PANEL)
    for to in formats():
        told = Bundle(views, VolumeGrid((8, 8, 8), 2.0), iter(images), "transmission", {})
        write_bundle(material / to, to, told)
        found.append(to)
    for name, text in (("nikon/nut.xtekct", XTEKCT), ("plain/scan.yaml", _yaml("*.tif"))):
        (material / name).parent.mkdir()
        (material / name).write_text(text)
        for view, image in enumerate(images):
            pixels = (50000 * image).astype(np.uint16)
            tifffile.imwrite((material / name).parent / f"nut_{view:04d}.tif", pixels)
        found.append(name)
    (material / "table").mkdir()
    np.save(material / "table" / "images.npy", images)
    np.savetxt(material / "table" / "angles.csv", np.degrees(angle))
    keys = {**CIRCLE, "angles": {"path": "angles.csv"}}
    stack = {"path": "images.npy", "values": "transmissions"}
    (material / "table" / "scan.yaml").write_text(json.dumps({"images": stack, "geometry": keys}))
    for name, write in (("hdf5", _hdf5), ("zarr", _zarr)):
        (material / name).mkdir()
        write(material / name, images)
        stack = {"path": f"images.{name}", "values": "transmissions"}
        keys = {**CIRCLE, "angles": {"step": 360 / VIEWS}}
        text = json.dumps({"images": stack, "geometry": keys})
        (material / name / "scan.yaml").write_text(text)
        found.append(f"{name}/scan.yaml")
    (material / "dicom").mkdir()
    write_dicom(material / "dicom")
    for view, file in enumerate(sorted((material / "dicom").iterdir())):
        told = pydicom.dcmread(file)
        pixels = 50000 * images[view % VIEWS, : told.Rows, : told.Columns]
        told.PixelData = np.ascontiguousarray(pixels).astype("<u2").tobytes()
        told.RescaleIntercept, told.InstanceNumber = 0, view + 1
        told.save_as(file)
    (material / "dicom" / "scan.yaml").write_text(_yaml("*.dcm"))
    (material / "ctsimu").mkdir()
    write_ctsimu(material / "ctsimu")
    write_meshes(material / "ctsimu")
    scenario = load_ctsimu(material / "ctsimu" / "small.json")
    files = render(scenario, material / "ctsimu" / "out", Options(1, 1, 0))
    metadata = str(files.metadata.relative_to(material))
    return [*found, "table/scan.yaml", "dicom/scan.yaml", metadata]


def _hdf5(folder: Path, images: Any) -> None:
    with h5py.File(folder / "images.hdf5", "w") as file:
        file.create_dataset("scan/images", data=images, chunks=(1, 12, 16), compression="gzip")
        file["scan"].attrs["camera"] = "none"


def _zarr(folder: Path, images: Any) -> None:
    zarr.create_array(str(folder / "images.zarr"), data=images, chunks=(1, 12, 8))


def _yaml(pattern: str) -> str:
    images = {"path": pattern, "values": "intensities", "white": 50000}
    return json.dumps({"images": images, "geometry": {**CIRCLE, "angles": {"step": 360 / VIEWS}}})
