"""Meshes and CT volumes from files: an asymmetric body must come out in place."""

from __future__ import annotations

import io
import plistlib
import sys
import tarfile
from pathlib import Path

import nibabel
import numpy as np
import pytest
import trimesh
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from twinct.core.errors import SpecimenError
from twinct.geometry import VolumeGrid
from twinct.scenario import Specimen
from twinct.specimen import build_specimen

CRANIUM = Path("/usr/share/doc/invesalius-examples/examples/Cranium.inv3")

SPACING = np.array([0.8, 1.0, 1.5])
"""Voxel edges along RAS x, y, z, mm."""
PLACE_MM = 0.05
"""Faces of an axis-aligned body lie half-way between two voxel values: exact but for rounding."""


def build(shape, **keys):
    return build_specimen(Specimen.model_validate({"parts": [{"shape": shape, **keys}]}))


def head():
    """(x, y, z) HU in RAS order: three bars of 1000 HU in air, no two alike.

    Its long bar spans x 4-20, its upright z 3-15 at the low end of x, its foot points to +y.
    """
    volume = np.full((28, 24, 20), -1000.0, dtype=np.float32)
    volume[4:20, 6:9, 3:6] = 1000
    volume[4:8, 6:9, 3:15] = 1000
    volume[4:8, 6:18, 3:6] = 1000
    return volume


ORIGIN = np.array([-11.0, 7.0, 30.0])
AFFINE = np.block([[np.diag(SPACING), ORIGIN[:, None]], [np.zeros(3), 1]])
LOW = ORIGIN + SPACING * (np.array([4, 6, 3]) - 0.5)
HIGH = ORIGIN + SPACING * (np.array([20, 18, 15]) - 0.5)


def assert_in_place(mesh, inside):
    """Bounds of the body in RAS, and its three bars at the ends where they belong."""
    assert mesh.is_watertight and mesh.volume > 0
    assert mesh.bounds == pytest.approx(np.array([LOW, HIGH]), abs=PLACE_MM)
    voxels = (head() > 0).sum() * SPACING.prod()
    assert mesh.volume == pytest.approx(voxels, rel=0.08)  # its edges are bevelled by half a voxel
    ends = [ORIGIN + SPACING * np.array(at) for at in ((18, 7, 4), (6, 7, 13), (6, 16, 4))]
    others = [ORIGIN + SPACING * np.array(at) for at in ((18, 7, 13), (18, 16, 4), (6, 16, 13))]
    assert inside(mesh, ends).all()
    assert not inside(mesh, others).any()


@pytest.mark.parametrize("flips", [(1, 1, 1), (-1, 1, 1), (-1, -1, 1), (1, 1, -1)])
def test_nifti_in_place_whatever_its_axes(tmp_path, flips, inside):
    volume, affine = head(), AFFINE.copy()
    for axis, flip in enumerate(flips):
        if flip < 0:
            volume = np.flip(volume, axis)
            affine[:3, 3] += affine[:3, axis] * (volume.shape[axis] - 1)
            affine[:3, axis] *= -1
    volume, affine = volume.transpose(2, 0, 1), affine[:, [2, 0, 1, 3]]
    nibabel.save(nibabel.Nifti1Image(volume, affine), tmp_path / "head.nii.gz")
    shape = {"kind": "ct", "path": tmp_path / "head.nii.gz", "threshold_hu": 0, "centre": False}
    assert_in_place(build(shape).parts[0].mesh, inside)


def test_ct_truth_and_centre(tmp_path):
    nibabel.save(nibabel.Nifti1Image(head(), AFFINE), tmp_path / "head.nii")
    built = build({"kind": "ct", "path": tmp_path / "head.nii", "threshold_hu": 0})
    assert built.bounds.mean(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    grid = VolumeGrid((60, 60, 60), 0.5)
    total = built.truth(grid, 80.0).sum(dtype=float) * 0.5**3
    wanted = built.parts[0].volume_mm3 * built.reference_mu(80.0)
    assert total == pytest.approx(wanted, rel=2e-3)


def test_body_cut_by_the_border_is_closed(tmp_path):
    volume = np.full((10, 12, 14), 500.0, dtype=np.float32)
    volume[:3] = -1000
    nibabel.save(nibabel.Nifti1Image(volume, np.eye(4)), tmp_path / "cut.nii")
    mesh = build({"kind": "ct", "path": tmp_path / "cut.nii", "threshold_hu": 300}).parts[0].mesh
    assert mesh.is_watertight
    # The padding is -1000 HU: the surface lies 2/15 voxel outside of the last value.
    wanted = (6 + 2 / 15 + 2 / 15) * (11 + 4 / 15) * (13 + 4 / 15)
    assert mesh.volume == pytest.approx(wanted, rel=0.03)


def test_crumbs_are_left_out(tmp_path, inside):
    volume = head()
    volume[24:26, 20:22, 16:18] = 1000
    nibabel.save(nibabel.Nifti1Image(volume, AFFINE), tmp_path / "head.nii")
    shape = {"kind": "ct", "path": tmp_path / "head.nii", "threshold_hu": 0, "centre": False}
    assert_in_place(build({**shape, "smallest_part_cm3": 0.1}).parts[0].mesh, inside)
    assert build({**shape, "smallest_part_cm3": 0}).bounds[1, 1] > HIGH[1] + 1
    with pytest.raises(SpecimenError, match="smallest_part_cm3 50"):
        build({**shape, "smallest_part_cm3": 50})


def write_dicom(folder, *, series=None, description="head", skip=None, modality="CT"):
    """An axial series: columns to the left, rows to the back, files in no order; slope 2, -1024."""
    folder.mkdir(exist_ok=True)
    series = series or generate_uid()
    volume = head()
    count = volume.shape[2]
    for k in range(count):
        if k == skip:
            continue
        meta = FileMetaDataset()
        meta.MediaStorageSOPClassUID = CTImageStorage
        meta.MediaStorageSOPInstanceUID = generate_uid()
        meta.TransferSyntaxUID = ExplicitVRLittleEndian
        # RAS (x, y) to LPS columns and rows.
        image = np.flip(volume[:, :, k], (0, 1)).T
        data = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
        data.SOPClassUID, data.SOPInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID
        data.Modality, data.SeriesInstanceUID, data.SeriesDescription = (
            modality,
            series,
            description,
        )
        data.Rows, data.Columns = image.shape
        data.PixelSpacing = [SPACING[1], SPACING[0]]
        data.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        last = ORIGIN + SPACING * (np.array(volume.shape) - 1)
        data.ImagePositionPatient = [-last[0], -last[1], ORIGIN[2] + SPACING[2] * k]
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 0
        data.RescaleSlope, data.RescaleIntercept = 2, -1024
        data.PixelData = ((image + 1024) / 2).astype("<u2").tobytes()
        data.save_as(folder / f"{(k * 7) % count:03d}-{series[-4:]}", enforce_file_format=True)


def test_dicom_series_in_place(tmp_path, inside):
    write_dicom(tmp_path / "series")
    (tmp_path / "series" / "README").write_text("not an image")
    shape = {"kind": "ct", "path": tmp_path / "series", "threshold_hu": 0, "centre": False}
    assert_in_place(build(shape).parts[0].mesh, inside)


def test_what_is_no_single_series_is_refused(tmp_path):
    write_dicom(tmp_path / "two", series="1.2.3.1111", description="bone kernel")
    write_dicom(tmp_path / "two", series="1.2.3.2222", description="soft kernel")
    write_dicom(tmp_path / "gap", skip=7)
    write_dicom(tmp_path / "mr", modality="MR")
    (tmp_path / "none").mkdir()
    for folder, words in {
        "two": ["2 series", "bone kernel", "soft kernel", "1.2.3.2222"],
        "gap": ["not evenly spaced", "missing"],
        "mr": ["MR"],
        "none": ["no DICOM image"],
    }.items():
        with pytest.raises(SpecimenError) as caught:
            build({"kind": "ct", "path": tmp_path / folder})
        for word in [*words, folder]:
            assert word in str(caught.value)


def write_inv3(path, volume, leave_out=()):
    """As InVesalius saves: slices upwards, rows to the front, columns to the left."""
    matrix = np.flip(volume, 0).transpose(2, 1, 0).astype("<i2")
    main = {
        "matrix": {"filename": "matrix.dat", "shape": list(matrix.shape), "dtype": "int16"},
        "spacing": [float(n) for n in SPACING],
        "orientation": 1,
    }
    with tarfile.open(path, "w:gz") as archive:
        for name, content in (
            ("main.plist", plistlib.dumps(main)),
            ("matrix.dat", np.ascontiguousarray(matrix).tobytes()),
        ):
            if name not in leave_out:
                entry = tarfile.TarInfo(f"tmpabc/{name}")
                entry.size = len(content)
                archive.addfile(entry, io.BytesIO(content))


def test_invesalius_project_keeps_orientation(tmp_path, inside):
    write_inv3(tmp_path / "head.inv3", head())
    shape = {"kind": "ct", "path": tmp_path / "head.inv3", "threshold_hu": 0}
    mesh = build(shape).parts[0].mesh
    mesh.apply_translation((LOW + HIGH) / 2)
    assert_in_place(mesh, inside)


@pytest.mark.data
@pytest.mark.skipif(not CRANIUM.is_file(), reason="needs Debian's invesalius-examples")
def test_real_cranium_stands_upright_and_faces_y():
    shape = {"kind": "ct", "path": CRANIUM, "threshold_hu": 300, "smallest_part_cm3": 50}
    built = build(shape)
    mesh = built.parts[0].mesh
    assert mesh.is_watertight and len(mesh.faces) <= 700_000
    # The head rest is gone: what is left is a head's width.
    assert 130 < np.ptp(built.bounds, axis=0)[0] < 160
    vertices = mesh.vertices
    top = vertices[vertices[:, 2].argmax()]
    assert np.abs(top[:2]).max() < 50, "the highest point is the vertex, not a cut or a jaw"
    front = vertices[vertices[:, 1].argmax()]
    assert abs(front[0]) < 20 and front[2] < 0, "the foremost point is the nose or the teeth"
    lowest = vertices[vertices[:, 2] < built.bounds[0, 2] + 3]
    assert np.median(lowest[:, 1]) > 5, "the volume ends below at upper teeth and jaw"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("absent.nii", None, ["does not exist"]),
        ("broken.nii", b"no image at all", ["cannot be read"]),
        ("broken.inv3", b"no archive at all", ["is not an InVesalius project"]),
        ("picture.jpg", b"JFIF", ["unknown format", ".nii", ".inv3", "DICOM"]),
    ],
)
def test_volume_that_cannot_be_read_is_named(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SpecimenError) as caught:
        build({"kind": "ct", "path": tmp_path / name})
    for word in [name, *words]:
        assert word in str(caught.value)


def test_incomplete_invesalius_project_is_named(tmp_path):
    write_inv3(tmp_path / "head.inv3", head(), leave_out=["matrix.dat"])
    with pytest.raises(SpecimenError, match="matrix.dat is missing"):
        build({"kind": "ct", "path": tmp_path / "head.inv3"})


@pytest.mark.parametrize(("threshold", "side"), [(3000, "nothing"), (-2000, "everything")])
def test_threshold_outside_of_the_values_gives_their_range(tmp_path, threshold, side):
    nibabel.save(nibabel.Nifti1Image(head(), AFFINE), tmp_path / "head.nii")
    with pytest.raises(SpecimenError) as caught:
        build({"kind": "ct", "path": tmp_path / "head.nii", "threshold_hu": threshold})
    for word in (side, f"{threshold}", "-1000 and 1000 HU"):
        assert word in str(caught.value)


def bracket():
    """A closed body without symmetry."""
    return trimesh.boolean.union(
        [
            trimesh.creation.box(bounds=[(0, 0, 0), (10, 3, 2)]),
            trimesh.creation.box(bounds=[(0, 0, 0), (2, 3, 7)]),
        ],
        engine="manifold",
    )


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_mesh_file_in_its_own_frame_and_unit(tmp_path, suffix):
    path = tmp_path / f"bracket.{suffix}"
    bracket().export(path)
    mesh = build({"kind": "mesh", "path": path, "unit_mm": 10}, material="titanium").parts[0].mesh
    assert mesh.is_watertight
    assert mesh.bounds == pytest.approx(np.array([(0, 0, 0), (100, 30, 70)]), abs=1e-4)
    assert mesh.volume == pytest.approx(bracket().volume * 1000, rel=1e-5)
    centred = build({"kind": "mesh", "path": path, "centre": True})
    assert centred.bounds == pytest.approx(np.array([(-5, -1.5, -3.5), (5, 1.5, 3.5)]), abs=1e-5)


def test_trivial_faults_are_mended(tmp_path):
    """Split vertices, some normals inwards, one triangle twice."""
    good = bracket()
    faces = good.faces.copy()
    faces[:5] = faces[:5, ::-1]
    faces = np.concatenate([faces, faces[7:8]])
    soup = trimesh.Trimesh(
        good.vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3), process=False
    )
    soup.export(tmp_path / "soup.ply")
    mesh = build({"kind": "mesh", "path": tmp_path / "soup.ply"}).parts[0].mesh
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(good.volume, rel=1e-6)


def test_inside_out_mesh_is_turned(tmp_path):
    mesh = bracket()
    mesh.invert()
    mesh.export(tmp_path / "inverted.stl")
    assert build({"kind": "mesh", "path": tmp_path / "inverted.stl"}).parts[0].mesh.volume > 0


def test_open_mesh_is_refused_with_its_open_edges(tmp_path):
    mesh = trimesh.creation.box((1, 1, 1))
    mesh.update_faces(np.arange(len(mesh.faces)) != 3)
    mesh.export(tmp_path / "open.stl")
    with pytest.raises(SpecimenError) as caught:
        build({"kind": "mesh", "path": tmp_path / "open.stl"}, name="lid")
    for word in ("open.stl", "'lid'", "3 of 18 edges"):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.stl", None, ["does not exist"]),
        ("empty.stl", b"solid a\nendsolid a\n", []),
        ("text.ply", b"hello", ["cannot be read"]),
        ("mesh.foo", b"hello", ["is not a mesh file", "STL"]),
    ],
)
def test_mesh_file_without_a_mesh_is_named(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(SpecimenError) as caught:
        build({"kind": "mesh", "path": tmp_path / name})
    for word in [name, *words]:
        assert word in str(caught.value)


def test_what_is_no_mesh_is_told_without_its_readers_troubles(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "charset_normalizer", None)  # as where nobody asks for it
    (tmp_path / "noise.stl").write_bytes(bytes(range(128, 256)) * 9)
    for path, said in ((tmp_path, "is a folder"), (tmp_path / "noise.stl", "is not a mesh file")):
        part = {"shape": {"kind": "mesh", "path": path}}
        with pytest.raises(SpecimenError, match=said) as caught:
            build_specimen(Specimen.model_validate({"parts": [part]}))
        assert "charset" not in str(caught.value) and "Module" not in str(caught.value)
