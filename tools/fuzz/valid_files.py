"""Small, asymmetric, valid files of every kind that a scenario may name."""

from __future__ import annotations

import io
import json
import plistlib
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import trimesh
from numpy.typing import NDArray

from twinct.ctsimu.writing import header, material_entry, placed, quantity
from twinct.geometry import Chain, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.calibrated_arms import ArmDeviations, CalibratedArms
from twinct.robots.motion import MotionPlan, save_plan

VOLUME = (12, 10, 8)

MJCF = """<mujoco model="arm"><worldbody><body name="base"><geom type="box" size=".05 .05 .05"/>
%s<geom type="capsule" size=".03" fromto="0 0 0 0 0 .1"/>%s</body></worldbody></mujoco>"""


def voxels() -> NDArray[np.int16]:
    """Return the voxels of a block in air, HU."""
    volume = np.full(VOLUME, -1000, dtype=np.int16)
    volume[3:9, 2:7, 2:6] = 800
    volume[3:5, 2:4, 2:4] = 1200
    return volume


def write_meshes(folder: Path) -> None:
    """Write one body as binary and text STL and PLY, and as OBJ and OFF."""
    box = trimesh.creation.box((4, 5, 6))
    box.apply_translation([30, 5, 2])
    body: Any = trimesh.util.concatenate([trimesh.creation.icosphere(1, 10.0), box])
    for name, kind in (
        *(("body.stl", "stl"), ("text.stl", "stl_ascii"), ("body.ply", "ply")),
        *(("body.obj", "obj"), ("body.off", "off")),
    ):
        body.export(folder / name, file_type=kind)
    body.export(folder / "text.ply", file_type="ply", encoding="ascii")
    with (folder / "body.obj").open("a") as stream:
        stream.write("mtllib other.mtl\nusemtl x\n")


def write_volumes(folder: Path) -> None:
    """Write one volume as NIfTI and as InVesalius project, both plain and compressed."""
    import nibabel

    for name in ("head.nii", "head.nii.gz"):
        image: Any = nibabel.Nifti1Image(voxels(), np.diag([1.0, 1.5, 2.0, 1.0]))  # type: ignore[no-untyped-call]
        image.to_filename(folder / name)
    matrix = np.ascontiguousarray(voxels().transpose(2, 1, 0)).astype("<i2")
    told = {"filename": "matrix.dat", "shape": list(matrix.shape), "dtype": "int16"}
    main = {"matrix": told, "spacing": [1.0, 1.5, 2.0], "orientation": 1}
    for name, mode in (("head.inv3", "w:gz"), ("plain.inv3", "w")):
        with tarfile.open(folder / name, mode) as archive:  # type: ignore[call-overload]
            for member, content in (
                ("main.plist", plistlib.dumps(main)),
                ("matrix.dat", matrix.tobytes()),
            ):
                entry = tarfile.TarInfo(f"tmp/{member}")
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))


def write_dicom(folder: Path) -> None:
    """Write an axial DICOM series of the volume."""
    from pydicom.dataset import FileDataset, FileMetaDataset
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian

    folder.mkdir(exist_ok=True)
    for k in range(VOLUME[2]):
        meta: Any = FileMetaDataset()
        meta.MediaStorageSOPClassUID = CTImageStorage
        meta.MediaStorageSOPInstanceUID = f"1.2.3.{k}"
        meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data: Any = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
        data.SOPClassUID, data.SOPInstanceUID = CTImageStorage, f"1.2.3.{k}"
        data.Modality, data.SeriesInstanceUID = "CT", "1.2.3"
        data.Rows, data.Columns = VOLUME[1], VOLUME[0]
        data.PixelSpacing, data.ImageOrientationPatient = [1.5, 1.0], [1, 0, 0, 0, 1, 0]
        data.ImagePositionPatient = [0.0, 0.0, 2.0 * k]
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.BitsAllocated, data.BitsStored, data.HighBit = 16, 16, 15
        data.PixelRepresentation, data.RescaleSlope, data.RescaleIntercept = 0, 1, -1024
        data.PixelData = (voxels()[:, :, k].T + 1024).astype("<u2").tobytes()
        data.save_as(folder / f"{k:03d}.dcm", enforce_file_format=True)


def write_tables(folder: Path) -> None:
    """Write a table of views and a curve."""
    rows = [
        [300 * np.cos(a), 300 * np.sin(a), 0, -300 * np.cos(a), -300 * np.sin(a), 0]
        for a in range(6)
    ]
    text = "\n".join(",".join(repr(float(x)) for x in row) for row in rows)
    (folder / "views.csv").write_text(f"# S and D\n{text}\n")
    curve = "\n".join(f"{x} {y}" for x, y in ((0, 1.0), (0.5, 0.8), (1, 0.5), (2, 0.1), (40, 0.0)))
    (folder / "curve.txt").write_text(f"# frequency, contrast\n{curve}\n")


def write_images(folder: Path) -> None:
    """Write one image of 12 x 16 pixels in all formats."""
    from PIL import Image

    pixels = (np.arange(192).reshape(12, 16) * 7 % 251).astype(np.uint8)
    np.save(folder / "image.npy", pixels.astype(np.float32))
    Image.fromarray(pixels).save(folder / "image.png")
    Image.fromarray(pixels).save(folder / "image.bmp")
    tifffile.imwrite(folder / "image.tif", pixels.astype(np.float32))
    tifffile.imwrite(folder / "packed.tif", pixels, compression="zlib")
    (folder / "image.raw").write_bytes(pixels.astype("<f4").tobytes())


def chains() -> tuple[Chain, Chain]:
    """Return two arms of three joints."""
    joints = np.stack(
        [Pose.from_euler((0, 0, 100.0 * k), (90.0 * k, 0, 0)).matrix for k in range(3)]
    )
    one = Chain(np.eye(4), joints, np.eye(4), np.ones(3), np.zeros((3, 3)), np.full(3, 50.0))
    return one, one


def write_arms(folder: Path) -> None:
    """Write calibrated arms, a motion plan of three views and a model of an arm."""
    change = ArmDeviations(np.full((3, 6), 1e-3), np.zeros(6), np.full(3, 1e-6), np.zeros((3, 2)))
    room = Pose.from_euler((1, 2, 3), (4, 5, 6))
    CalibratedArms(chains(), (change, change), 1, room, {"seed": 1}).write(folder / "arms.json")
    time_s = np.linspace(0.0, 4.0, 9)
    state = np.zeros((9, 3, 12))
    state[:, 0] = np.linspace(0, 1, 9)[:, None]
    views = np.array([-1, -1, 0, -1, 1, -1, 2, -1, -1])
    pose = (0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0)
    names = tuple(f"{side}_joint{k}" for side in ("source", "detector") for k in range(6))
    targets = (PosePairs.from_sevens([(pose, pose)]),) * 3
    near = (("source_link6", "specimen"),) * 3
    save_plan(
        MotionPlan(names, time_s, state, views, targets, np.full(3, 50.0), near),
        folder / "plan.npz",
    )
    link = '<body name="l%d" pos="0 0 .1"><joint name="j%d" range="-90 90" axis="%s"/>'
    inner = '<geom type="capsule" size=".03" fromto="0 0 0 0 0 .1"/>'
    bodies = inner.join(link % (k, k, "0 0 1" if k % 2 else "0 1 0") for k in range(6))
    (folder / "arm.xml").write_text(MJCF % (bodies, "</body>" * 6))


def write_ctsimu(folder: Path) -> None:
    """Write a CTSimU scenario of an aluminium body, with a file of drifts."""
    sample = {
        "name": "cube",
        "file": {"value": "body.stl"},
        "unit": "mm",
        "scaling_factor": {axis: quantity(1.0) for axis in "rst"},
        "material_id": "Al",
        "position": {
            "center": {axis: quantity(0.0, "mm") for axis in "uvw"},
            "vector_r": {"u": quantity(1), "v": quantity(0), "w": quantity(0)},
            "vector_t": {"u": quantity(0), "v": quantity(0), "w": quantity(1)},
            "deviations": [],
        },
    }
    (folder / "drift.csv").write_text("0\n0.5\n1.0\n")
    centre = quantity(200.0, "mm") | {"drifts": [{"file": "drift.csv", "unit": "mm"}]}
    stage = placed((200, 0, 0), (1, 0, 0), (0, 0, 1))
    stage["center"]["x"] = centre
    detector = {
        "type": "ideal",
        **{"columns": quantity(24, "px"), "rows": quantity(16, "px"), "bit_depth": quantity(16)},
        "pixel_pitch": {"u": quantity(2.0, "mm"), "v": quantity(2.0, "mm")},
        "integration_time": quantity(1.0, "s"),
        "gray_value": {"imax": quantity(60000), "imin": quantity(0)},
    }
    acquisition = {
        **{"start_angle": quantity(0.0, "deg"), "stop_angle": quantity(30.0, "deg")},
        **{"direction": "CCW", "scan_mode": "stop+go", "number_of_projections": 3},
        **{"include_final_angle": True, "frame_average": 1, "scattering": False},
        **{"dark_field": {"number": 0}, "flat_field": {"number": 0}},
    }
    told = {
        "file": header("small", "for fuzzing"),
        "environment": {"material_id": None},
        "geometry": {
            "detector": placed((400, 0, 0), (0, -1, 0), (1, 0, 0)),
            "source": {"type": "cone"} | placed((0, 0, 0), (0, -1, 0), (1, 0, 0)),
            "stage": stage,
        },
        "detector": detector,
        "source": {
            **{"voltage": quantity(80.0, "kV"), "current": quantity(1.0, "mA")},
            "spectrum": {"monochromatic": True},
        },
        "samples": [sample],
        "acquisition": acquisition,
        "materials": [
            material_entry("Al", 2.6989, {"Al": 1.0}),
            material_entry("Vacuum", 0.0, {"": 1.0}),
        ],
    }
    (folder / "small.json").write_text(json.dumps(told, indent=1))


def write_all(folder: Path) -> None:
    """Write the valid files of all kinds."""
    write_meshes(folder)
    write_volumes(folder)
    write_dicom(folder / "dicom")
    write_tables(folder)
    write_images(folder)
    write_arms(folder)
    write_ctsimu(folder)
