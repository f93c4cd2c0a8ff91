"""Geometry of measured scans: each form states the same views, and wrong numbers are named."""

from __future__ import annotations

import numpy as np
import pytest
from ball_scan import BALL, COLUMNS, PITCH, ROWS, SDD, SOD, VIEWS, ball_images, orbit
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.measured.circle import Circle
from twinct.measured.description import read_description
from twinct.measured.views import ImageFacts
from twinct.recon.field_of_view import grid_of

FACTS = ImageFacts(VIEWS, ROWS, COLUMNS)
POINTS = np.array([[0, 0, 0], BALL, [-7, 9, 4]])


def told(geometry, **images):
    return {"images": {"path": "a.npy", "values": "transmissions", **images}, "geometry": geometry}


def views(geometry, facts=FACTS):
    return read_description(told(geometry)).views(facts)


def same(found, expected=None):
    expected = orbit() if expected is None else expected
    np.testing.assert_allclose(found.project(POINTS), expected.project(POINTS), atol=1e-9)


def test_circle_is_the_orbit(circle):
    found = views(circle)
    same(found.geometry)
    assert not found.flip_rows and not found.flip_columns
    assert views(circle | {"rows": "down"}).flip_rows
    assert views(circle | {"columns": "left"}).flip_columns


@pytest.mark.parametrize(
    "change",
    [
        {"rotates": "object", "direction": "clockwise"},
        {"angles": {"first": 360, "step": -360 / VIEWS}, "direction": "clockwise"},
        {"angles": {"values": [360 / VIEWS * i for i in range(VIEWS)]}},
        {"angles": {"step": 2 * np.pi / VIEWS, "unit": "rad"}},
    ],
)
def test_other_words_for_the_same_circle(change, circle):
    same(views(circle | change).geometry)


def test_offsets_and_leans_of_the_circle(circle):
    """Against the machine at rest, written down again: x right, y ahead, z up."""
    keys = {
        "panel_offset_mm": [3.0, -2.0],
        "axis_offset_mm": 1.5,
        "axis_roll_deg": 2.0,
        "axis_tilt_deg": -1.0,
        "panel_roll_deg": 3.0,
        "panel_tilt_deg": 4.0,
        "panel_slant_deg": 0.0,
    }
    found = views(circle | keys).geometry
    axis = np.array([np.tan(np.radians(2.0)), np.tan(np.radians(-1.0)), 1.0])
    on_axis = found.source * [0, 0, 0]  # the world's origin lies on the axis
    assert np.linalg.norm(found.source - on_axis, axis=1) == pytest.approx(np.hypot(SOD, 1.5))
    # What all views share: angles between axis, panel and beam.
    axis /= np.linalg.norm(axis)
    up = Rotation.from_euler("x", -4, degrees=True).apply(
        [np.sin(np.radians(3)), 0, np.cos(np.radians(3))]
    )
    assert found.v @ [0, 0, 1] == pytest.approx(up @ axis, abs=2e-5)
    assert found.sdd == pytest.approx(
        np.full(VIEWS, abs(found.normal[0] @ (found.source[0] - found.detector[0])))
    )
    panel = np.array([3.0 - 1.5, SDD - SOD, -2.0])
    assert found.detector @ [0, 0, 1] == pytest.approx(panel @ axis, abs=2e-3)


def test_leans_act_in_the_order_of_the_formula(circle):
    """The formulas of docs/measured.md, element by element, with six different numbers."""
    keys = {
        "panel_offset_mm": [3.0, -2.0],
        "axis_offset_mm": 1.5,
        "axis_roll_deg": 7.0,
        "axis_tilt_deg": -11.0,
        "panel_roll_deg": 13.0,
        "panel_tilt_deg": 17.0,
        "panel_slant_deg": -23.0,
    }
    r, t, big_r, big_t, big_s = np.radians([7.0, -11.0, 13.0, 17.0, -23.0])
    cr, sr, ct, st = np.cos(big_r), np.sin(big_r), np.cos(big_t), np.sin(big_t)
    cs, ss = np.cos(big_s), np.sin(big_s)
    u = np.array([cs * cr, ct * ss * cr - st * sr, -st * ss * cr - ct * sr])
    v = np.array([cs * sr, ct * ss * sr + st * cr, -st * ss * sr + ct * cr])
    axis = np.array([np.sin(r), np.sin(t) * np.cos(r), np.cos(t) * np.cos(r)])
    # The world of angle 0: z along the axis, and x towards the source: -y of the leaning machine.
    x = -np.array([0, np.cos(t), -np.sin(t)])
    world = np.stack([x, np.cross(axis, x), axis])
    on_axis = np.array([1.5, SOD, 0.0])
    found = views(circle | keys).geometry
    for vector, told in ((found.u, u), (found.v, v)):
        np.testing.assert_allclose(vector[0], world @ told, atol=1e-12)
    np.testing.assert_allclose(found.source[0], world @ -on_axis, atol=1e-9)
    np.testing.assert_allclose(found.detector[0], world @ ([3.0, SDD, -2.0] - on_axis), atol=1e-9)


def test_matrices_in_every_convention(tmp_path):
    geometry = orbit()
    to_mm = geometry.panel.mm_from_pixel
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    metres = np.diag([1000.0, 1000.0, 1000.0, 1.0])
    down = np.array([[1, 0, 0], [0, -1, ROWS - 1.0], [0, 0, 1.0]])
    scale = np.random.default_rng(0).uniform(-2, 2, (VIEWS, 1, 1))
    for matrices, keys, flipped in (
        (geometry.matrices() * scale, {"to": "px", "origin": "pixel_centre"}, False),
        (half @ geometry.matrices(), {"to": "px", "origin": "pixel_corner"}, False),
        (to_mm @ geometry.matrices(), {"to": "mm", "origin": "panel_centre"}, False),
        (geometry.matrices() @ metres, {"to": "px", "origin": "pixel_centre", "world": "m"}, False),
        (down @ geometry.matrices(), {"to": "px", "origin": "pixel_centre"}, True),
    ):
        np.save(tmp_path / "p.npy", matrices)
        section = {"kind": "matrices", "path": str(tmp_path / "p.npy"), "pitch_mm": PITCH, **keys}
        found = views(section)
        same(found.geometry)
        assert found.flip_rows == flipped


def test_tables_of_poses(tmp_path):
    geometry = orbit()
    rows = np.hstack([geometry.source, geometry.detector, geometry.u, geometry.v])
    quats = np.array([pose.quat for pose in geometry.detector_poses()])
    short = np.hstack([geometry.source / 10, geometry.detector / 10, np.roll(quats, 1, axis=1)])
    for table, keys in ((rows, {}), (short, {"unit": "cm", "quaternion": "wxyz"})):
        path = tmp_path / "poses.csv"
        np.savetxt(path, table, delimiter=",", header="source, panel, ...", fmt="%.17g")
        same(views({"kind": "poses", "path": str(path), "pitch_mm": PITCH, **keys}).geometry)


XTEKCT = f"""[XTekCT]
Name=nut
Projections={VIEWS}
DetectorPixelsX={COLUMNS}
DetectorPixelsY={ROWS}
DetectorPixelSizeX={PITCH}
DetectorPixelSizeY={PITCH}
SrcToObject={SOD}
SrcToDetector={SDD}
InitialAngle=0
AngularStep={360 / VIEWS}
WhiteLevel=50000
MaskRadius=30
VoxelSizeX=0.3
Exponent=1.0
Scaling=1000.0
TIFFScaling=1
LowPercentile=0.2
HighPercentile=99.8
ObjectOffsetX=0.7
[Xrays]
XraykV=180
"""


def test_xtekct_is_a_circle_with_its_axis_to_the_left(tmp_path):
    path = tmp_path / "nut.xtekct"
    path.write_text(XTEKCT)
    found = views({"kind": "nikon", "path": str(path)})
    shifted = Circle(
        kind="circle",
        sod_mm=SOD,
        sdd_mm=SDD,
        pitch_mm=PITCH,
        angles={"step": 360 / VIEWS},
        rotates="object",
        direction="clockwise",
        axis_offset_mm=-0.7,
    )
    same(found.geometry, shifted.views(FACTS).geometry)
    assert found.flip_rows and found.flip_columns


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("MaskRadius=30", "DetectorOffsetX=1.2", "DetectorOffsetX is '1.2', and may matter"),
        (f"SrcToObject={SOD}", "", "key SrcToObject is missing"),
        (f"SrcToObject={SOD}", "SrcToObject=far", "SrcToObject is 'far', not a finite number"),
        (f"Projections={VIEWS}", "Projections=inf", "Projections is 'inf', not a finite number"),
        (f"Projections={VIEWS}", "Projections=9", "9 views, but there are 24 images"),
        (f"DetectorPixelsX={COLUMNS}", "DetectorPixelsX=9", "20 x 9 pixels .* 20 x 26"),
        ("[XTekCT]", "[Other]", "no section"),
    ],
)
def test_bad_xtekct_is_named(old, new, message, tmp_path):
    path = tmp_path / "nut.xtekct"
    path.write_text(XTEKCT.replace(old, new))
    with pytest.raises(InputError, match=message):
        views({"kind": "nikon", "path": str(path)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"angles": {"step": 2 * np.pi / VIEWS}}, "in radians"),
        ({"angles": {"step": 15.0, "unit": "rad"}}, "in degrees"),
        ({"angles": {"values": [0.0, 1.0]}}, "2 angles, but there are 24 images"),
        ({"angles": {}}, "one of step, values and path"),
        ({"sdd_mm": 100}, r"sdd_mm \(100\) must exceed sod_mm \(200\)"),
        ({"sod_mm": None}, "geometry.*sod_mm"),
        ({"rotates": "sample"}, "rotates"),
    ],
)
def test_bad_circle_is_named(change, message, circle):
    with pytest.raises(InputError, match=message):
        views(circle | change)


def spoilt(at, value):
    matrices = orbit().matrices().copy()
    matrices[at] = value
    return matrices


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        (spoilt((3, 2), 0.0), "matrix 3 lacks full rank"),
        (spoilt((3, 1), orbit().matrices()[3, 0]), "matrix 3 lacks full rank"),
        (orbit().matrices()[:5], "5 views, but there are 24 images"),
        (orbit().matrices() * [[[1.0], [2.0], [1.0]]], "rows 1 mm apart .* is 2 mm"),
        (np.zeros((24, 3, 3)), r"expected \(views, 3, 4\)"),
        (spoilt((3, 1, 1), np.nan), "not finite"),
    ],
)
def test_bad_matrices_are_named(matrices, message, tmp_path):
    np.save(tmp_path / "p.npy", matrices)
    keys = {"to": "px", "origin": "pixel_centre", "pitch_mm": PITCH}
    with pytest.raises(InputError, match=message):
        views({"kind": "matrices", "path": str(tmp_path / "p.npy"), **keys})


@pytest.mark.parametrize(
    ("vectors", "detector", "message"),
    [
        (
            lambda a: a * ([[1.0]] * 3 + [[1.1]] + [[1.0]] * 20),
            (ROWS, COLUMNS),
            "of view 3 are 2.2",
        ),
        (lambda a: a.reshape(48, 6), (ROWS, COLUMNS), r"shape \(48, 6\); expected \(views, 12\)"),
        (lambda a: a, (ROWS, COLUMNS + 0.5), "expected two numbers of pixels"),
        (lambda a: a, (ROWS, COLUMNS, 1), "expected two numbers of pixels"),
    ],
)
def test_bad_vectors_of_astra_are_named(vectors, detector, message, tmp_path):
    geometry, file = orbit(), tmp_path / "geometry.npz"
    parts = geometry.source, geometry.detector, PITCH * geometry.u, PITCH * geometry.v
    np.savez(file, vectors=vectors(np.hstack(parts)), detector=detector)
    with pytest.raises(InputError, match=message):
        views({"kind": "astra", "path": str(file)})


def test_cutting_and_binning_keep_every_ray(circle, stored, imported):
    """A pixel of the smaller panel lies where its pixels lay, whichever way the rows run."""
    images = np.arange(VIEWS * ROWS * COLUMNS, dtype=float).reshape(VIEWS, ROWS, COLUMNS) / 1e5
    crop = {"top": 2, "bottom": 4, "left": 3, "right": 1}
    keys = {"crop": crop, "bin": 2, "every": 3}
    section = stored(images, "transmissions", **keys)
    scan, _ = imported({"images": section, "geometry": circle | {"rows": "down"}})
    assert scan.transmission.shape == (8, 7, 11)
    cut = images[::3, 2:-4, 3:-1]
    blocks = cut.reshape(8, 7, 2, 11, 2).mean(axis=(2, 4))[:, ::-1]
    np.testing.assert_allclose(scan.transmission, blocks, rtol=1e-6)
    whole = orbit()[::3]
    for view in (0, 5):
        # Rows run down: the cut bottom is the first rows of the panel.
        old = whole.pixel_centres(view)[4:-2, 3:-1].reshape(7, 2, 11, 2, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(scan.geometry().pixel_centres(view), old, atol=1e-9)


@pytest.mark.parametrize(
    ("stored_as", "keys"),
    [
        (lambda a: a[:, ::-1], {"flip_rows": True}),
        (lambda a: a[:, :, ::-1], {"flip_columns": True}),
        (lambda a: a.transpose(0, 2, 1), {"transpose": True}),
        (lambda a: np.rot90(a, -1, (1, 2)), {"turn_deg": 90}),
        (lambda a: a.transpose(1, 0, 2), {"axes": ["row", "view", "column"]}),
        (lambda a: a.transpose(2, 1, 0), {"axes": ["column", "row", "view"]}),
    ],
)
def test_images_are_turned_as_stated(stored_as, keys, circle, stored, imported):
    images = ball_images(orbit())
    scan, _ = imported({"images": stored(stored_as(images), **keys), "geometry": circle})
    np.testing.assert_allclose(scan.line_integrals(), images, atol=1e-6)


def test_a_shifted_panel_has_the_grid_of_the_wide_side(circle):
    centred = grid_of(views(circle).geometry)
    shifted = {**circle, "panel_offset_mm": [8.0, 0.0]}
    wide = grid_of(views(shifted).geometry)
    assert wide["voxel_mm"] == pytest.approx(centred["voxel_mm"], rel=1e-5)
    assert wide["voxels"][0] == centred["voxels"][0] + 2 * 4
    assert wide["voxels"][2] == centred["voxels"][2]


def test_a_moved_world_has_its_grid_where_the_beams_meet(stored, imported, tmp_path):
    moved = Pose.from_euler((500.0, -20.0, 30.0), (0, 0, 0)) @ orbit()
    table = np.hstack([moved.source, moved.detector, moved.u, moved.v])
    np.save(tmp_path / "poses.npy", table)
    section = {"kind": "poses", "path": str(tmp_path / "poses.npy"), "pitch_mm": PITCH}
    scan, _ = imported({"images": stored(ball_images(orbit())), "geometry": section})
    grid = scan.settings.reconstruction.volume_grid
    assert grid.world_from_grid.position == pytest.approx([500, -20, 30], abs=1e-3)
