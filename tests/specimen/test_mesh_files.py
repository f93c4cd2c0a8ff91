"""Mesh files: which are read, and why others are refused (docs/readers.md)."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trimesh

from twinct.core.errors import SpecimenError
from twinct.core.files.meshes import read_mesh
from twinct.scenario import Specimen
from twinct.specimen import build_specimen, preview

MODELS = Path(__file__).parents[2] / "data" / "trimesh" / "models"
"""The models in trimesh's repository, which none of its packages contains."""


def box(at: float = 0.0) -> Any:
    return trimesh.creation.box(bounds=[(at, 0, 0), (at + 1, 2, 3)])


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a body as text, with some texts replaced."""

    def write(kind: str, body: Any, *changes: tuple[str, str]) -> Path:
        exported = body.export(file_type={"stl": "stl_ascii"}.get(kind, kind), **_ENCODING[kind])
        text = exported.decode() if isinstance(exported, bytes) else exported
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / f"body.{kind}"
        path.write_text(text, encoding="utf-8")
        return path

    return write


_ENCODING: dict[str, dict[str, str]] = {
    "ply": {"encoding": "ascii"},
    "stl": {},
    "obj": {},
    "off": {},
}
KINDS = sorted(_ENCODING)


@pytest.mark.parametrize("kind", KINDS)
def test_text_formats_keep_every_body(written: Callable[..., Path], kind: str) -> None:
    two = trimesh.util.concatenate([box(), box(5.0)])
    mesh = read_mesh(written(kind, two), "it")
    assert mesh.volume == pytest.approx(12) and mesh.body_count == 2
    assert mesh.bounds.ravel() == pytest.approx([0, 0, 0, 6, 2, 3])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("word", ["abc", "2_0", "1,5", "0x10", "٣", "nan", "inf", "1e999", ""])
def test_a_coordinate_is_a_finite_number(
    written: Callable[..., Path], kind: str, word: str
) -> None:
    path = written(kind, trimesh.util.concatenate([box(), box(5.0)]))
    lines = path.read_text(encoding="utf-8").split("\n")
    places = [i for i, line in enumerate(lines) if line.split(" ")[-1].startswith("3.0")]
    lines[places[-1]] = f"{lines[places[-1]].rpartition(' ')[0]} {word}"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(SpecimenError, match=r"^it (cannot be read|holds)"):
        read_mesh(path, "it")


def test_a_picture_that_a_mesh_names_is_not_looked_for(
    written: Callable[..., Path], capfd: pytest.CaptureFixture[str], caplog: Any
) -> None:
    uv = ("property float z", "property float z\nproperty float s\nproperty float t")
    path = written("ply", box(), uv)
    head, mark, rest = path.read_text().partition("end_header\n")
    rows = rest.split("\n")
    number = len(box().vertices)
    rows[:number] = [f"{row} 0.5 0.5" for row in rows[:number]]
    named = head.replace("element vertex", "comment TextureFile absent.png\nelement vertex")
    path.write_text(named + mark + "\n".join(rows))
    assert read_mesh(path, "it").volume == pytest.approx(6)
    assert capfd.readouterr() == ("", "") and not caplog.records


@pytest.mark.parametrize(
    ("kind", "place", "piece"),
    [
        ("obj", "\nf ", "\nusemtl m{}\nf "),
        ("stl", "facet normal", "endsolid\nsolid s{}\nfacet normal"),
    ],
)
def test_pieces_of_a_body_are_joined_before_they_are_read(
    written: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, kind: str, place: str, piece: str
) -> None:
    ball = trimesh.creation.icosphere(3, 5.0)
    path = written(kind, ball)
    text = path.read_text()
    first, *others = text.split(place)
    assert len(others) == 1280
    path.write_text(first + "".join(piece.format(i) + each for i, each in enumerate(others)))
    made: list[object] = []
    make = trimesh.Trimesh.__init__

    def counted(self: object, *given: Any, **keys: Any) -> None:
        made.append(self)
        make(self, *given, **keys)

    monkeypatch.setattr(trimesh.Trimesh, "__init__", counted)
    assert read_mesh(path, "it").volume == pytest.approx(ball.volume, rel=1e-4)
    assert len(made) < 10


def test_polygons_become_triangles(tmp_path: Path) -> None:
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 2) for z in (0, 3))
    quads = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf -7 -3 -1 -5\n"
    (tmp_path / "box.obj").write_text(corners + quads)
    mesh = read_mesh(tmp_path / "box.obj", "it")
    assert mesh.volume == pytest.approx(6) and len(mesh.faces) == 12


def test_a_cut_file_is_refused(tmp_path: Path) -> None:
    for kind in ("stl", "ply"):
        data = box().export(file_type=kind)
        (tmp_path / f"cut.{kind}").write_bytes(data[:-30])
        with pytest.raises(SpecimenError, match="^it (cannot be read|holds no triangles)"):
            read_mesh(tmp_path / f"cut.{kind}", "it")


@pytest.mark.parametrize("kind", KINDS)
def test_only_a_file_is_read(tmp_path: Path, kind: str) -> None:
    os.mkfifo(tmp_path / f"pipe.{kind}")
    (tmp_path / f"zero.{kind}").symlink_to("/dev/zero")
    for name, what in (("pipe", r"named pipe \(FIFO\)"), ("zero", "device")):
        with pytest.raises(SpecimenError, match=f"^it is a {what}, not a file"):
            read_mesh(tmp_path / f"{name}.{kind}", "it")


def test_the_picture_of_a_tiny_body_takes_no_more_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scipy import ndimage

    sigmas: list[float] = []
    monkeypatch.setattr(
        ndimage, "gaussian_filter", lambda image, sigma: (sigmas.append(sigma), image)[1]
    )
    shape = {"kind": "box", "size_mm": [1, 1, 1]}
    built = build_specimen(Specimen.model_validate({"parts": [{"shape": shape}]}))
    preview.preview_specimen(built, tmp_path / "picture.png")
    assert sigmas and max(sigmas) < 200  # of a picture about 600 pixels wide; it was 5,000


@pytest.mark.data
@pytest.mark.skipif(not MODELS.is_dir(), reason="needs the repository of trimesh in data/trimesh")
def test_the_models_of_trimesh_are_read_right_or_refused(
    capfd: pytest.CaptureFixture[str],
) -> None:
    known = {
        **dict.fromkeys(("unit_cube.STL", "cube.OBJ", "BoxTextured.ply", "cube_blender_uv.ply"), 1),
        **{"box.obj": 8, "cube_compressed.obj": 8, "negative_indices.obj": 8, "tet.ply": 4 / 3},
    }
    files = [f for f in MODELS.rglob("*") if f.is_file()]
    ours = [f for f in files if f.suffix.lower() in (".stl", ".ply", ".obj", ".off")]
    volumes: dict[str, float] = {}
    for file in files:
        try:
            volumes[file.name] = read_mesh(file, "it").volume
        except SpecimenError as error:
            assert str(error).startswith("it ") and len(str(error)) < 300
    assert {name: volumes[name] for name in known} == pytest.approx(known, rel=1e-5)
    assert volumes.keys() <= {file.name for file in ours}  # other endings are refused
    assert len(volumes) > len(ours) / 2 and capfd.readouterr() == ("", "")
