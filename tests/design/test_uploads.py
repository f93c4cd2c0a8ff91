"""Uploads are kept in the draft's folder, bounded, and refused with a reason."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twinct.core.errors import InputError
from twinct.design import uploads
from twinct.design.bench import Bench
from twinct.design.draft import Draft
from twinct.design.uploads import KINDS, SURFACE, ReceivedSpecimen, forget, kept, plain_name
from twinct.geometry import VolumeGrid
from twinct.recon.volume import Volume
from twinct.recon.volume_formats import VolumeFacts
from twinct.scan import SimulationBuilder


def ball(radius_mm: float = 30.0) -> bytes:
    made = trimesh.creation.icosphere(radius=radius_mm).export(file_type="stl")
    assert isinstance(made, bytes)
    return made


def zipped(**files: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def test_a_mesh_becomes_the_specimen(small_file: Path) -> None:
    draft = Draft.open(small_file)
    path = kept(small_file, "My Ball.STL", ball())
    assert path == small_file.with_name("small_files") / "My-Ball.stl"
    found = ReceivedSpecimen(draft.source, path).answered(Bench())
    assert found.words == ("My-Ball.stl: 60.0 x 60.0 x 60.0 mm",)
    draft.apply(found.edit)
    assert draft.scenario is not None and not draft.problems
    (part,) = draft.scenario.specimen.parts
    assert (part.name, part.shape.kind, part.material) == ("My-Ball", "mesh", "bone")
    assert "path: small_files/My-Ball.stl" in draft.text  # moves with the scenario
    assert "trajectory: {views: 12} # few" in draft.text


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["scan.nii", "series.zip"])
def test_a_ct_becomes_the_specimen(small_file: Path, tmp_path: Path, name: str, kind: str) -> None:
    """A ball of bone with a radius of 12 mm, in 1 mm voxels of air, as NIfTI and as DICOM."""
    grid = VolumeGrid([33, 33, 33], 1.0)
    z, y, x = np.indices(grid.shape) - 16.0
    hu = np.where(x**2 + y**2 + z**2 < 12.0**2, 1000.0, -1000.0).astype(np.float32)
    volume, facts = Volume(hu, grid), VolumeFacts(unit="HU", kvp=120)
    if name == "scan.nii":
        volume.write(tmp_path / name)
        content = (tmp_path / name).read_bytes()
    else:
        volume.write(tmp_path / "series", to="dicom", facts=facts)
        content = zipped(**{f.name: f.read_bytes() for f in (tmp_path / "series").iterdir()})
    draft = Draft.open(small_file)
    found = ReceivedSpecimen(draft.source, kept(small_file, name, content), kind).answered(Bench())
    draft.apply(found.edit)
    assert draft.scenario is not None and not draft.problems
    (part,) = draft.scenario.specimen.parts
    assert part.shape.kind == ("ct" if kind == SURFACE else "volume")
    low, high = SimulationBuilder(draft.scenario).specimen.bounds
    # The surface passes between voxels; bodies of voxels end at their faces.
    np.testing.assert_allclose(high - low, 24.0, atol=1.5)


def test_a_unit_counts_and_what_is_larger_than_the_volume_is_said(small_file: Path) -> None:
    path = kept(small_file, "ball.stl", ball(10.0))
    found = ReceivedSpecimen(Draft.open(small_file).source, path, unit_mm=10.0).answered(Bench())
    assert found.words[0] == "ball.stl: 200.0 x 200.0 x 200.0 mm"
    assert "larger than the volume, 120 x 144 x 168 mm" in found.words[1]


def test_a_second_file_of_this_name_replaces_none(small_file: Path) -> None:
    first, second = (kept(small_file, "ball.stl", ball(size)) for size in (10.0, 20.0))
    assert first != second and first.read_bytes() == ball(10.0)


def test_a_file_that_the_readers_refuse_is_refused(small_file: Path) -> None:
    path = kept(small_file, "ball.stl", b"solid nothing")
    with pytest.raises(InputError, match="holds no triangles"):
        ReceivedSpecimen(Draft.open(small_file).source, path).answered(Bench())
    forget(path)
    assert not path.exists()


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("ball.exe", b"MZ", "expected a file of a specimen"),
        ("ball.stl", b"", "is empty"),
        ("head.zip", b"PK no more", "no ZIP file that can be read"),
        ("head.zip", zipped(), "holds 0 files"),
    ],
)
def test_what_is_no_specimen_is_refused(
    small_file: Path, name: str, content: bytes, why: str
) -> None:
    with pytest.raises(InputError, match=why):
        kept(small_file, name, content)
    folder = small_file.with_name("small_files")
    assert not folder.exists() or not list(folder.iterdir())


def test_large_uploads_are_refused(small_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "LARGEST_UPLOAD", 10)
    with pytest.raises(InputError, match="has 11 bytes; the limit is 10"):
        kept(small_file, "ball.stl", b"x" * 11)


def test_a_zip_of_much_is_refused(small_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "unpacked_limit", lambda packed: 1000)
    with pytest.raises(InputError, match="holds 4000 bytes; the limit is 1000"):
        kept(small_file, "a.zip", zipped(a=bytes(2000), b=bytes(2000)))
    monkeypatch.setattr(uploads, "MOST_FILES", 1)
    with pytest.raises(InputError, match="holds 2 files; expected 1 to 1"):
        kept(small_file, "a.zip", zipped(a=b"1", b=b"2"))


def test_names_in_a_zip_lead_nowhere(small_file: Path) -> None:
    folder = kept(small_file, "../../etc/series.zip", zipped(**{"../../a": b"1", "/b": b"2"}))
    assert folder.parent == small_file.with_name("small_files") and folder.name == "series"
    assert [path.read_bytes() for path in sorted(folder.iterdir())] == [b"1", b"2"]
    assert sorted(path.name for path in small_file.parent.iterdir()) == [
        "small.yaml",
        "small_files",
    ]


def test_a_zip_of_one_mesh_is_that_mesh(small_file: Path) -> None:
    path = kept(small_file, "bundle.zip", zipped(**{"in/ball.stl": ball()}))
    assert path.suffix == ".stl" and path.read_bytes() == ball()


def test_names_are_plain() -> None:
    assert plain_name("C:\\scans\\Große Büste (1).stl") == "Gro-e-B-ste--1"
    assert plain_name(".stl") == "specimen"
