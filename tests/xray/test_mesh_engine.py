"""The engines mesh and cuda_mesh against exact numbers, also on vertices, edges and faces."""

from __future__ import annotations

import os
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from math import sqrt
from typing import NamedTuple

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from xray_scenes import random_view, specimen

from twinct.core.card import DEVICE_VARIABLE
from twinct.core.errors import SpecimenError
from twinct.geometry import Floats, Panel, Pose, ScanGeometry
from twinct.rays import Surface, _crossings
from twinct.rays.mesh_rays import frame_of
from twinct.scenario import Detector, Source, Specimen
from twinct.specimen import build_specimen
from twinct.xray import Imager
from twinct.xray.engine import SceneBody
from twinct.xray.engines import engine_named

EXACT_MM = 0.01
"""Required, for the worst ray."""
ROUNDED = 1e-6
"""Single precision of the largest line integrals."""
PANEL = Panel(120, 160, 1.6, 1.5)
CELL = 4
"""Columns and rows between planes of a lattice body."""
NEAREST, STEPS = 10, 32
"""Lattice depths are whole numbers of STEPS-ths of the way to the panel, from NEAREST on."""


class Solid(NamedTuple):
    """A closed mesh, in a lattice of rays and depths or in mm."""

    vertices: Floats
    faces: NDArray[np.int64]


Lengths = Callable[[ScanGeometry, Panel, Solid], NDArray[np.float32]]


@pytest.fixture(params=["mesh", "cuda_mesh"])
def name(request, monkeypatch) -> str:
    """Name of an engine; the card's kernels run on the processor, unless a card is named."""
    monkeypatch.setenv(DEVICE_VARIABLE, os.environ.get(DEVICE_VARIABLE) or "cpu")
    return request.param


@pytest.fixture
def lengths_of(name: str) -> Lengths:
    """Path lengths in a solid, by either engine."""
    return partial(_lengths_of, name)


def _lengths_of(name: str, view: ScanGeometry, panel: Panel, solid: Solid) -> NDArray[np.float32]:
    engine = engine_named(name).engine
    engine.acquire([SceneBody(*solid)], panel)
    lengths = np.full(panel.shape, np.nan, np.float32)
    engine.path_lengths(view, 0, lengths)
    return lengths


def whole_view(rng: np.random.Generator, panel: Panel) -> ScanGeometry:
    """An oblique view whose numbers, and those of all its lattice points, are exact doubles."""
    axes = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], (3, 1))
    u, v = axes[0], axes[1]
    normal = np.cross(u, v)
    aside = rng.integers(-60, 60, 3).astype(float)
    source = aside + 300 * normal + rng.integers(-90, 90) * u + rng.integers(-90, 90) * v
    centre = aside - rng.integers(250, 350) * normal
    return ScanGeometry(source[None], centre[None], u[None], v[None], panel)


def rays_of(view: ScanGeometry, panel: Panel) -> tuple[Floats, Floats, Floats]:
    """Vector from the source to pixel (0, 0), and the steps to the next column and row."""
    across, up = panel.pitch_u * view.u[0], panel.pitch_v * view.v[0]
    middle = (panel.columns - 1) / 2 * across + (panel.rows - 1) / 2 * up
    return view.detector[0] - view.source[0] - middle, across, up


def placed(solid: Solid, view: ScanGeometry, panel: Panel) -> Solid:
    """The mesh in mm of one whose corners are (column, row, depth) of the view's lattice."""
    first, across, up = rays_of(view, panel)
    column, row, depth = solid.vertices.T[..., None]
    corners = view.source[0] + depth / STEPS * (first + column * across + row * up)
    return Solid(corners, solid.faces)


def outwards(solid: Solid) -> Solid:
    a, b, c = np.moveaxis(solid.vertices[solid.faces], 1, 0)
    inside_out = np.einsum("ij,ij", a, np.cross(b, c)) < 0
    return Solid(solid.vertices, solid.faces[:, ::-1] if inside_out else solid.faces)


def surface_of(filled: NDArray[np.bool_], rng: np.random.Generator) -> Solid:
    """Boundary of some cells of a lattice, each square cut along either diagonal."""
    shape = np.array(filled.shape) + 1
    points = np.indices(shape).reshape(3, -1).T
    index = np.arange(len(points)).reshape(shape)
    padded = np.pad(filled, 1)
    faces = []
    for axis in range(3):
        step, one, other = np.roll(np.eye(3, dtype=int), -axis, axis=0)
        for cell in np.argwhere(padded & ~np.roll(padded, 1, axis)) - 1:
            faces.append([cell, cell + other, cell + one + other, cell + one])
        for cell in np.argwhere(padded & ~np.roll(padded, -1, axis)) - 1 + step:
            faces.append([cell, cell + one, cell + one + other, cell + other])
    corners = np.array([[index[tuple(point)] for point in face] for face in faces])
    turned = np.take_along_axis(
        corners, (np.arange(4) + rng.integers(0, 2, (len(corners), 1))) % 4, axis=1
    )
    triangles = np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])
    return Solid(points * [CELL, CELL, 2.0] + [CELL, CELL, NEAREST], triangles)


@pytest.mark.parametrize("seed", range(12))
def test_rays_along_edges_and_faces_of_lattice_bodies_are_exact(
    seed: int, lengths_of: Lengths, figure
) -> None:
    """Each side of each cell lies in rays; the others are cut by rays along their diagonals.

    A ray that leaves a body less often than it enters it, or the reverse, is off by at least the
    distance to the source, 78 mm.
    """
    rng = np.random.default_rng(seed)
    panel = Panel(120, 160, *rng.choice([0.5, 1.0, 2.0], 2))
    view, filled = whole_view(rng, panel), rng.random((38, 28, 4)) < 0.4
    solid = outwards(placed(surface_of(filled, rng), view, panel))
    first, across, up = rays_of(view, panel)
    row, column = np.indices(panel.shape)
    ways = first + column[..., None] * across + row[..., None] * up
    cell_mm = 2 / STEPS * np.linalg.norm(ways, axis=-1)
    padded = np.pad(filled, ((1, 2), (1, 2), (0, 0)))
    cells = padded[column // CELL, row // CELL]
    # A ray in a side of cells belongs to those at higher columns and rows.
    error = np.abs(lengths_of(view, panel, solid) - cells.sum(axis=2) * cell_mm)
    touching = (column % CELL == 0) | (row % CELL == 0) | ((column + row) % CELL == 0)
    touching &= (abs(column - 80) <= 76) & (abs(row - 60) <= 56)
    figure(f"{touching.sum()} touching rays, worst {error.max():.1e} mm")
    assert touching.sum() > 8_500 and error.max() < EXACT_MM
    # Rounded by a rotation, such a ray passes cells on either side.
    turn = Rotation.random(random_state=rng).as_matrix()
    vectors = view.source, view.detector, view.u, view.v
    turned = ScanGeometry(*(vector @ turn.T for vector in vectors), panel)
    lengths = lengths_of(turned, panel, Solid(solid.vertices @ turn.T, solid.faces))
    beside = [
        padded[(column - left) // CELL, (row - below) // CELL]
        for left in (0, 1)
        for below in (0, 1)
    ]
    least = np.logical_and.reduce(beside).sum(axis=2) * cell_mm
    most = np.logical_or.reduce(beside).sum(axis=2) * cell_mm
    assert (lengths > least - EXACT_MM).all() and (lengths < most + EXACT_MM).all()


def star(rng: np.random.Generator) -> Solid:
    """A dented ball whose corners are whole numbers of columns, rows and depths."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    radius = rng.uniform(0.8, 1.2, (len(ball.vertices), 1))
    corners = np.round(ball.vertices * radius * [30, 25, 6] + [80, 60, NEAREST + 8])
    return Solid(corners, np.asarray(ball.faces))


def summed(solid: Solid) -> tuple[dict[tuple[int, int], Fraction], int]:
    """Depths at which rays leave, less those at which they enter, and how many meet an edge."""
    total: dict[tuple[int, int], Fraction] = {}
    touched = set()
    for triangle in solid.vertices[solid.faces].astype(int):
        (left, low, _), (right, high, _) = triangle.min(axis=0), triangle.max(axis=0)
        column, row = np.meshgrid(np.arange(left, right + 1), np.arange(low, high + 1))
        sides, signs = [], []
        for a, b in ((1, 2), (2, 0), (0, 1)):
            (xa, ya, _), (xb, yb, _) = triangle[a], triangle[b]
            side = (xa - column) * (yb - row) - (xb - column) * (ya - row)
            sides.append(side)
            # A step along columns changes the side by ya - yb, along rows by xb - xa.
            signs.append(np.where(side, np.sign(side), np.sign(ya - yb) or np.sign(xb - xa)))
        within = (np.abs(np.sum(signs, axis=0)) == 3) & (signs[0] != 0)
        closed = (np.array(sides) >= 0).all(axis=0) | (np.array(sides) <= 0).all(axis=0)
        touching = closed & (np.array(sides) == 0).any(axis=0)
        touched.update(zip(column[touching].tolist(), row[touching].tolist(), strict=True))
        for i, j in np.argwhere(within).tolist():
            parts = [int(side[i, j]) for side in sides]
            inverse = sum(Fraction(p, int(k)) for p, k in zip(parts, triangle[:, 2], strict=True))
            at = int(column[i, j]), int(row[i, j])
            total[at] = total.get(at, Fraction()) - int(signs[0][i, j]) * sum(parts) / inverse
    return total, len(touched)


@pytest.mark.parametrize("seed", range(8))
def test_path_lengths_of_stars_are_those_of_fractions(
    seed: int, lengths_of: Lengths, figure
) -> None:
    rng = np.random.default_rng(100 + seed)
    panel = Panel(120, 160, *rng.choice([0.5, 1.0, 2.0], 2))
    view, lattice = whole_view(rng, panel), star(rng)
    first, across, up = rays_of(view, panel)
    depths, touched = summed(lattice)
    truth = np.zeros(panel.shape)
    for (column, row), depth in depths.items():
        way = first + column * across + row * up
        truth[row, column] = float(depth / STEPS) * sqrt(way @ way)
    turned = outwards(placed(lattice, view, panel))
    flipped = not np.array_equal(turned.faces, lattice.faces)
    lengths = lengths_of(view, panel, turned)
    error = np.abs(lengths - np.maximum(-truth if flipped else truth, 0)).max()
    figure(f"{touched} touching rays, worst {error:.1e} mm")
    assert touched > 500 and error < EXACT_MM


def convex(points: Floats) -> tuple[Solid, Floats]:
    """The convex hull of points, and its half-spaces."""
    mesh = ConvexHull(points)
    faces = np.array(mesh.simplices, dtype=np.int64)
    a, b, c = (points[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), mesh.equations[:, :3]) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return Solid(points, faces), mesh.equations


def stone(rng: np.random.Generator, centre: Floats, size_mm: float) -> tuple[Solid, Floats]:
    scales = rng.uniform(0.3, 1.0, 3) * size_mm
    points = rng.normal(size=(20, 3)) * scales
    return convex(centre + Rotation.random(random_state=rng).apply(points))


def across_beam(rng: np.random.Generator, view: ScanGeometry) -> Floats:
    """Any direction in the panel's plane."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.cos(angle) * view.u[0] + np.sin(angle) * view.v[0]


def interval(source: Floats, rays: Floats, planes: Floats) -> tuple[Floats, Floats]:
    """Where rays enter and leave the half-spaces, in lengths of their vectors; 0 at the source."""
    height, steep = planes[:, :3] @ source + planes[:, 3], rays @ planes[:, :3].T
    with np.errstate(divide="ignore"):
        at = -height / steep
    enter = np.where(steep < 0, at, 0.0).max(axis=-1)
    leave = np.where(steep > 0, at, np.inf).min(axis=-1)
    return np.maximum(enter, 0.0), leave


def clipped(view: ScanGeometry, *solids: Floats) -> Floats:
    """Length of each ray within all of the convex bodies, mm."""
    rays = view.pixel_centres(0) - view.source[0]
    ends = [interval(view.source[0], rays, planes) for planes in solids]
    enter, leave = (np.array(side) for side in zip(*ends, strict=True))
    share = np.maximum(leave.min(axis=0) - enter.max(axis=0), 0.0)
    return share * np.linalg.norm(rays, axis=-1)


def test_convex_polyhedra_are_clipped_rays(lengths_of: Lengths, figure) -> None:
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(20):
        view = random_view(rng, PANEL, np.zeros(3))
        solid, planes = stone(rng, rng.uniform(-20, 20, 3), rng.uniform(5, 40))
        truth = clipped(view, planes)
        assert (truth > 0).sum() > 20
        errors.append(np.abs(lengths_of(view, PANEL, solid) - truth).max())
    figure(f"convex polyhedra: worst pixel {max(errors):.1e} mm")
    assert max(errors) < EXACT_MM


def test_bodies_beside_and_behind_the_source_are_clipped_rays(lengths_of: Lengths, figure) -> None:
    """The plane through the source, parallel to the panel, cuts most of them."""
    rng = np.random.default_rng(2)
    panel = Panel(40, 50, 45.0, 45.0)
    errors, hit, cut = [], 0, 0
    for _ in range(30):
        view = random_view(rng, panel, np.zeros(3))
        centre = (
            view.source[0] + 150 * across_beam(rng, view) + rng.uniform(-60, 60) * view.normal[0]
        )
        solid, planes = stone(rng, centre, 50)
        if (planes[:, :3] @ view.source[0] + planes[:, 3] < 0).all():
            continue
        depth = (view.source[0] - solid.vertices) @ view.normal[0]
        cut += bool(depth.min() < 0 < depth.max())
        truth = clipped(view, planes)
        hit += bool((truth > 0).any())
        errors.append(np.abs(lengths_of(view, panel, solid) - truth).max())
    figure(f"beside the source: worst of {hit} bodies {max(errors):.1e} mm")
    assert hit > 10 and cut > 20 and max(errors) < EXACT_MM


def test_slivers_across_the_panel_are_clipped_rays(lengths_of: Lengths) -> None:
    """Long diagonal triangles, whose rows are narrowed."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        view = random_view(rng, PANEL, np.zeros(3))
        axis = across_beam(rng, view)
        angle = np.arange(60) * 2 * np.pi / 60
        ring = 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        across, up = np.cross(axis, view.normal[0]), view.normal[0]
        rod = np.concatenate([ring @ [across, up] + end * axis for end in (-400, 400)])
        rod += 2 * rng.normal(size=3)
        solid, planes = convex(rod)
        truth = clipped(view, planes)
        assert (truth > 0).sum() > 30
        assert np.abs(lengths_of(view, PANEL, solid) - truth).max() < EXACT_MM


def test_results_do_not_depend_on_the_bands_of_threads() -> None:
    rng = np.random.default_rng(4)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=40.0)
    view = random_view(rng, PANEL, np.zeros(3))
    frame, body, found = frame_of(view), Surface.of(ball.vertices, ball.faces), []
    places = np.empty((len(body.vertices), 3))
    _crossings.project(body.vertices, frame.seen, places)
    for limits in ([0, 120], [0, 1, 60, 60, 61, 120], list(range(121))):
        total = np.zeros(PANEL.shape)
        bands = np.array(limits)
        arrays = body.vertices, body.faces, frame.seen, places, bands
        _crossings.add_crossings(*arrays, 1.0, total)
        found.append(total)
    assert found[0].max() > 0
    assert all(np.array_equal(found[0], total) for total in found[1:])


BONE = {"shape": {"kind": "box", "size_mm": [60, 44, 50]}, "material": "bone"}
PIN = {
    "shape": {"kind": "box", "size_mm": [20, 90, 14]},
    "material": "titanium",
    "rotation_deg": [30, 20, 10],
}


def half_spaces(shape: dict, pose: Pose) -> Floats:
    normals = np.concatenate([pose.rotation.T, -pose.rotation.T])
    offset = np.tile(np.array(shape["size_mm"]) / 2, 2) + normals @ pose.position
    return np.concatenate([normals, -offset[:, None]], axis=1)


@pytest.mark.parametrize("pin_last", [True, False])
def test_where_parts_overlap_the_later_one_wins(pin_last: bool, name: str, figure) -> None:
    parts = [BONE, PIN] if pin_last else [PIN, BONE]
    built = build_specimen(Specimen.model_validate({"parts": parts}))
    detector = Detector(columns=PANEL.columns, rows=PANEL.rows, pixel_pitch_mm=(1.5, 1.6))
    planes = {
        "bone": half_spaces(BONE["shape"], Pose.identity()),
        "titanium": half_spaces(PIN["shape"], Pose.from_euler([0, 0, 0], PIN["rotation_deg"])),
    }
    mu = {part.material.name: part.material.mu_per_mm(80.0) for part in built.parts}
    assert set(mu) == set(planes)
    rng = np.random.default_rng(5)
    errors = []
    with Imager(Source(), detector, built, engine=name) as imager:
        for _ in range(5):
            view = random_view(rng, detector.panel, np.zeros(3))
            image = imager.render(view, Pose.identity()).astype(np.float64)
            truth = sum(mu[name] * clipped(view, planes[name]) for name in mu)
            first = parts[0]["material"]
            both = clipped(view, *planes.values())
            assert both.max() > 10
            truth = truth - mu[first] * both
            visible = truth < 5  # single precision of the transmission
            errors.append(np.abs(-np.log(image) - truth)[visible].max() / mu["bone"])
    figure(f"overlapping parts: worst pixel {max(errors):.1e} mm of bone")
    assert max(errors) < EXACT_MM


def test_open_meshes_are_refused() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=20.0)
    ball.update_faces(np.arange(len(ball.faces)) > 0)
    with pytest.raises(SpecimenError, match="is an open mesh"):
        Imager(Source(), Detector(), specimen((ball, 0.02)), engine="mesh")
