"""Folders of Nikon machines: encodings, names of images, files of angles, contradictions."""

from __future__ import annotations

import re

import numpy as np
import pytest
import tifffile
from ball_scan import BALL, COLUMNS, PITCH, ROWS, SDD, SOD, VIEWS, ball_images, orbit

import twinct
from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.measured import import_measured
from twinct.measured.description import read_description
from twinct.measured.views import ImageFacts

STEP = 360 / VIEWS
WHITE = 50000
XTEKCT = f"""[XTekCT]
Name=nut
Projections={VIEWS}
DetectorPixelsX={COLUMNS}
DetectorPixelsY={ROWS}
DetectorPixelSizeX={PITCH}
DetectorPixelSizeY={PITCH}
SrcToObject={SOD}
SrcToDetector={SDD}
InitialAngle=30
AngularStep={STEP}
WhiteLevel={WHITE}
InputSeparator=_
InputFolderName=
[Xrays]
XraykV=180
"""
POINTS = np.array([[0, 0, 0], BALL, [-7, 9, 4]])
EVEN = STEP * np.arange(VIEWS)
UNEVEN = EVEN + np.random.default_rng(0).uniform(-4, 4, VIEWS) * (EVEN > 0)


@pytest.fixture
def folder(tmp_path):
    """A function that writes a scan: the file's text, its encoding, the images' folder and name."""

    def write(text=XTEKCT, encoding="utf-8", images=".", name="nut_{:04d}.tif"):
        path = tmp_path / "part.xtekct"
        path.write_bytes(text.encode(encoding))
        (tmp_path / images).mkdir(exist_ok=True, parents=True)
        counts = np.round(WHITE * np.exp(-ball_images(orbit()))).astype(np.uint16)
        for index, image in enumerate(counts[:, ::-1, ::-1]):
            tifffile.imwrite(tmp_path / images / name.format(index + 1), image)
        return path

    return write


def turned(degrees):
    """Return the projections of the points for these angles of the machine's stage."""
    angle = np.radians(degrees)
    x, y = POINTS[:, :2].T
    back = np.stack(
        [
            np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y,
            -np.sin(angle)[:, None] * x + np.cos(angle)[:, None] * y,
            np.tile(POINTS[:, 2], (len(angle), 1)),
        ],
        axis=-1,
    )
    return np.array([orbit()[:1].project(points)[0] for points in back])


def views(path, **keys):
    section = {"kind": "nikon", "path": str(path), **keys}
    told = {"images": {"path": "a", "values": "transmissions"}, "geometry": section}
    return read_description(told).views(ImageFacts(VIEWS, ROWS, COLUMNS))


def is_turned(found, degrees):
    np.testing.assert_allclose(found.geometry.project(POINTS), turned(degrees), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        (XTEKCT, {}),
        (XTEKCT, {"encoding": "utf-16"}),
        (XTEKCT, {"encoding": "utf-16-be"}),
        (XTEKCT + "[A]\nOperatorID=Müller µ\n", {"encoding": "cp1252"}),
        (XTEKCT.replace("[XTekCT]", "[XtekCT]").replace("SrcTo", "SRCTO"), {}),
        (XTEKCT.replace("\n", "\r\n").replace(str(PITCH), "2,0"), {"encoding": "utf-8-sig"}),
        (XTEKCT.replace("InputFolderName=", "InputFolderName=proj"), {"images": "proj"}),
        (XTEKCT.replace("InputFolderName=", r"InputFolderName=D:\x\proj"), {"images": "proj"}),
        (XTEKCT.replace("InputFolderName=", r"InputFolderName=a\b"), {"images": "a/b"}),
        (XTEKCT.replace("InputSeparator=_", "InputSeparator=-"), {"name": "nut-{:04d}.tif"}),
        (XTEKCT.replace("InputSeparator=_", "InputSeparator="), {"name": "nut{:04d}.tif"}),
        (XTEKCT.replace("InputSeparator=_\n", ""), {"name": "NUT_{:04d}.TIF"}),
        (XTEKCT.replace("Name=nut", "Name=n[1]"), {"name": "n[1]_{:04d}.tiff"}),
        (XTEKCT.replace("Name=nut", "Name=renamed"), {}),
        (XTEKCT.replace("Name=nut", "AutoComment\nName=nut"), {}),
    ],
)
def test_a_folder_as_machines_write_it(text, keys, folder, tmp_path):
    path = folder(text, **keys)
    if "renamed" not in text:  # images of other names do not count
        tifffile.imwrite(path.parent / "flat_0001.tif", np.zeros((3, 3), np.uint16))
    import_measured(path, tmp_path / "out")
    scan = twinct.load_scan(tmp_path / "out")
    truth = np.exp(-ball_images(orbit()))
    np.testing.assert_allclose(scan.transmission, truth, atol=1e-5)
    np.testing.assert_allclose(scan.geometry().project(POINTS), turned(EVEN + 30), atol=1e-6)


def test_the_file_is_given_from_python_and_on_the_command_line(folder, tmp_path, capsys):
    path = folder(XTEKCT.replace("InitialAngle", "TimeStampFolder=1\nWobble=3\nInitialAngle"))
    twinct.import_scan(str(path), tmp_path / "a")
    result = import_measured(str(path), tmp_path / "b")
    assert "part.xtekct: unknown keys, not used: TimeStampFolder (1), Wobble (3)" in result.notes
    assert run_command(["import", str(path), "--out", str(tmp_path / "c")]) == 0
    assert "unknown keys, not used: TimeStampFolder (1)" in capsys.readouterr().out
    path.write_text(XTEKCT.replace(f"SrcToObject={SOD}", "SrcToObject=0"))
    assert run_command(["import", str(path), "--out", str(tmp_path / "d")]) == 2
    assert "SrcToObject is 0; it must be above 0" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


def ctdata(angles):
    lines = "".join(f"{i + 1}\t{angle:.6f}\t{0.5 * i}\n" for i, angle in enumerate(angles))
    heads = f"Projs\tFrames\tExposure(ms)\n{len(angles)}\t1\t500\nProjection\tAngle(deg)\tTime(s)\n"
    return heads + lines


def ang(angles):
    return "Proj\tAngle(deg)\n" + "".join(f"{i + 1}:\t{a:.6f}\n" for i, a in enumerate(angles))


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("_ctdata.txt", ctdata(UNEVEN + 30), UNEVEN + 30),
        ("_ctdata.txt", ctdata(UNEVEN), UNEVEN + 30),
        ("nut_ctdata.txt", ctdata((UNEVEN + 180) % 360 - 180), UNEVEN + 30),
        ("_CTdata.txt", ctdata(UNEVEN).replace(".", ","), UNEVEN + 30),
        ("nut.ang", ang(UNEVEN + 30), UNEVEN + 30),
        ("part.ang", ang(UNEVEN[::-1] + 30), UNEVEN + 30),
        ("alone.ang", ang(-UNEVEN), UNEVEN + 30),
        ("nut.ang", ang(UNEVEN).replace(":", "").replace("\t", " "), UNEVEN + 30),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_files_of_angles(name, text, expected, encoding, folder):
    path = folder()
    (path.parent / name).write_bytes(text.encode(encoding))
    found = views(path)
    is_turned(found, expected)
    assert any(note.startswith(f"{name}: angles 30 to ") for note in found.notes)
    assert not found.doubts
    is_turned(views(path, angles="steps"), EVEN + 30)


def test_ctdata_comes_before_ang_and_its_departure_is_named(folder):
    path = folder()
    (path.parent / "_ctdata.txt").write_text(ctdata(EVEN * 0.5))
    (path.parent / "nut.ang").write_text(ang(EVEN))
    found = views(path)
    is_turned(found, 0.5 * EVEN + 30)
    assert "depart from AngularStep (15 deg) by up to 172 deg: geometry.angles: steps" in str(
        found.doubts
    )


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"_ctdata.txt": ctdata(EVEN[:7])}, "_ctdata.txt: 7 angles, but .* states 24 projections"),
        ({"_ctdata.txt": ctdata(-EVEN)}, "change by -15 deg from view to view, but AngularStep"),
        ({"nut.ang": "Proj\tAngle(deg)\n1:\tx\n"}, "nut.ang: angles: no line holds numbers"),
        ({"nut.ang": ""}, "nut.ang"),
        ({"nut.ang": ang(EVEN), "part.ang": ang(EVEN)}, "which file has its angles, nut.ang or"),
    ],
)
def test_bad_files_of_angles_are_named(files, message, folder):
    path = folder()
    for name, text in files.items():
        (path.parent / name).write_text(text)
    with pytest.raises(InputError, match=message):
        views(path)
    is_turned(views(path, angles="steps"), EVEN + 30)


@pytest.mark.parametrize(
    ("more", "doubt"),
    [
        ("ObjectOffsetX=0.7\nCentreOfRotationTop=1.05\nCentreOfRotationBottom=1.05", None),
        ("ObjectOffsetX=0.7\nCentreOfRotationTop=0\nCentreOfRotationBottom=0", None),
        ("ObjectOffsetX=", None),
        (
            "ObjectOffsetX=0.5\nCentreOfRotationTop=9\nCentreOfRotationBottom=6",
            "two centres: the axis is 0.5 mm from .* by ObjectOffsetX, but 5 mm by .*9 and 6 mm",
        ),
        (
            "ObjectRoll=3\nCentreOfRotationTop=1\nCentreOfRotationBottom=-1",
            "two rolls of the axis: 3 deg by ObjectRoll, but -2.86",
        ),
    ],
)
def test_contradicting_centres_are_named(more, doubt, folder, tmp_path):
    path = folder(XTEKCT.replace("InitialAngle", f"{more}\nInitialAngle"))
    found = views(path)
    assert len(found.doubts) == (doubt is not None)
    if doubt:
        assert re.search(doubt, found.doubts[0])
        key = more.partition("=")[0]
        assert not views(path, ignore=[key]).doubts
        assert doubt.split(":")[0] in str(import_measured(path, tmp_path / "out").doubts)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (f"SrcToDetector={SDD}", "SrcToDetector=100", r"SrcToDetector \(100\) must exceed SrcTo"),
        (f"DetectorPixelSizeX={PITCH}", "DetectorPixelSizeX=-1", "is -1; it must be above 0"),
        (f"AngularStep={STEP}", "AngularStep=", "the key AngularStep is missing"),
        ("InitialAngle=30", "InitialAngle=1,2,3", "InitialAngle is '1,2,3', not a finite number"),
        ("[XTekCT]\n", "", "not an .xtekct file"),
        ("WhiteLevel=50000\n", "", "WhiteLevel is missing"),
    ],
)
def test_bad_files_are_named(old, new, message, folder, tmp_path):
    path = folder(XTEKCT.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        import_measured(path, tmp_path / "out")
    assert "part.xtekct" in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_images_that_are_missing_are_named(tmp_path):
    path = tmp_path / "part.xtekct"
    path.write_text(XTEKCT.replace("InputFolderName=", "InputFolderName=proj"))
    with pytest.raises(InputError, match=r"no image nut_0001.tif, nor any other TIFF file, is in"):
        import_measured(path, tmp_path / "out")
    with pytest.raises(InputError, match="does not exist"):
        import_measured(tmp_path / "none.xtekct", tmp_path / "out")
