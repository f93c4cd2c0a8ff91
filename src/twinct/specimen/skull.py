"""The built-in adult skull, from implicit surfaces.

The zero level of a signed distance field becomes a closed mesh. The field of the half x >= 0 is
mirrored, so the skull is exactly symmetric.

Design frame: x to the skull's left or right (symmetric), y anterior, z superior, mm, origin in the
middle of the vault. The finished surface is moved so that the middle of its bounds is the origin.
Proportions follow textbook craniometry of an adult: vault 180 x 145 x 135 mm, bizygomatic width
about 130, orbits 39 x 34, nasal aperture 25 wide, foramen magnum 30 x 35 mm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.disk_cache import made_once
from twinct.geometry import Floats
from twinct.specimen.canvas import Canvas
from twinct.specimen.implicit import Field, ImplicitSolid, Point, block, chain, ellipsoid, rod, wall
from twinct.specimen.surface import surface

if TYPE_CHECKING:
    import trimesh

LOWEST: Point = (0.0, -98.0, -146.0)
HIGHEST: Point = (80.0, 106.0, 76.0)
"""Corners of the lattice in the design frame, mm."""

WALL_MM = 6.3
"""Thickness of the vault's wall, before sutures and ridges."""


SOURCES = ("skull.py", "implicit.py", "canvas.py", "surface.py")
"""Files of this package that make the surface."""


@lru_cache(maxsize=2)
def _cached(scale: float, resolution_mm: float) -> trimesh.Trimesh:
    from importlib.metadata import version  # only here: imports of twinct load few modules

    texts = [Path(__file__).with_name(name).read_bytes() for name in SOURCES]
    libraries = [f"{name} {version(name)}" for name in ("numpy", "scipy", "scikit-image")]
    numbers = repr((scale, resolution_mm, *libraries, version("manifold3d")))
    mesh = made_once(
        "skull",
        [*texts, numbers.encode()],
        lambda: _arrays(_made(scale, resolution_mm)),
    )
    return surface(mesh["vertices"], mesh["faces"].astype(np.int64))


def _arrays(mesh: trimesh.Trimesh) -> dict[str, NDArray[Any]]:
    return {"vertices": mesh.vertices.view(np.ndarray), "faces": mesh.faces.astype(np.int32)}


def _made(scale: float, resolution_mm: float) -> trimesh.Trimesh:
    mesh = _without_crumbs(skull_canvas(resolution_mm / scale).surface())
    vertices = (mesh.vertices - mesh.bounds.mean(axis=0)) * scale
    return surface(vertices, mesh.faces)


def skull_surface(scale: float = 1.0, resolution_mm: float = 1.0) -> trimesh.Trimesh:
    """Return the closed surface of the skull: face towards +y, middle of its bounds at the origin.

    Args:
        scale: 1 is adult size.
        resolution_mm: cell of the lattice for the surface extraction, mm of the scaled skull.
    """
    return _cached(float(scale), float(resolution_mm)).copy()


def skull_canvas(step: float, margin_mm: float = 0.0) -> Canvas:
    """Return the adult skull on half a lattice with cells of ``step`` mm, in the design frame."""
    low, high = np.subtract(LOWEST, (0, margin_mm, margin_mm)), np.add(HIGHEST, margin_mm)
    canvas = Canvas(step, low, high)
    for part in (_braincase, _base, _face, _cheeks, _openings, _jaw, _teeth):
        canvas.draw(*part())
    return canvas


UPPER_ARCH = (29.5, 50.0)
LOWER_ARCH = (27.5, 47.5)
"""Semi-axes across and along of the quarter ellipses on which the teeth stand, mm."""
ARCH_Y = 37.0
"""Approximate y of the last molars."""
UPPER_TEETH = (8.6, 6.8, 7.6, 7.0, 6.8, 10.2, 9.6)
LOWER_TEETH = (5.6, 6.2, 7.0, 7.0, 7.2, 11.0, 10.4)
"""Mesiodistal widths, mm: two incisors, canine, two premolars, two molars."""
UPPER_CROWN_Z = (-86.5, -97.0)
LOWER_CROWN_Z = (-99.0, -108.5)
"""Z range of the crowns, mm: upper neck and edge, lower edge and neck. The teeth do not touch."""


def vault() -> ImplicitSolid:
    """Return the braincase's outer surface with its floor; the inner one is WALL_MM inside."""
    back = ellipsoid((0, -14, 2), (71.5, 76, 65))
    front = ellipsoid((0, 24, 4), (58, 63, 57))
    egg = back.joined(front, 26)

    def floor(y: Field) -> Field:
        # Height of the skull base: posterior fossa, with steps at the clivus and the frontal fossa.
        return -61.0 + 9.0 * (1 + np.tanh((y - 4) / 9)) + 14.5 * (1 + np.tanh((y - 40) / 9))

    def slope(y: Field) -> Field:
        return 1.0 / (1 + 9 * np.cosh(np.clip((y - 4) / 9, -9, 9)) ** -4 * 0.4)

    box_low, box_high = egg.low - 6, egg.high + 6
    above = ImplicitSolid(lambda x, y, z: (floor(y) - z) * slope(y) + 0 * x, box_low, box_high)
    return egg.within(above, 14)


def _braincase() -> Iterator[ImplicitSolid]:
    outer = vault()

    def sutures(x: Field, y: Field, z: Field) -> Field:
        zig = 1.2 * np.sin(x * 1.1) + 0.8 * np.sin(x * 0.47 + 1)
        upper = 1 / (1 + np.exp(-(z + 5) / 3))
        coronal = np.abs(y - (24 - 0.16 * x + 0.05 * (60 - z)) - zig)
        lambdoid = np.abs(y + 62 - 0.012 * x * x - 0.5 * (z - 38) - zig)
        groove = np.exp(-((coronal / 1.1) ** 2)) * upper
        groove = np.maximum(groove, np.exp(-((lambdoid / 1.1) ** 2)) * (y < -20))
        sagittal = np.abs(x - 0.4 * np.sin(y * 0.9) - 0.4)
        between = (y < 25) & (z > 25)
        return np.maximum(groove, np.exp(-((sagittal / 1.1) ** 2)) * between)

    def shell(x: Field, y: Field, z: Field) -> Field:
        d = outer(x, y, z)
        return np.maximum(d + 0.9 * sutures(x, y, z), -(d + WALL_MM))

    yield ImplicitSolid(shell, outer.low - 3, outer.high + 3)
    # Brow ridges and glabella, temporal lines, occipital protuberance with its nuchal line.
    brow = [(0, 84, -17), (8, 85, -14.5), (16, 85, -12), (26, 82.5, -10)]
    brow += [(36, 77, -10), (48, 66, -15)]
    yield chain(brow, [4.5, 4.8, 4.8, 4.4, 4.2, 4.6]).blended(10)
    line = [(49, 63, -14), (52, 56, -4), (54.5, 47, 8), (57, 35, 20), (58, 19, 28), (57, 3, 32)]
    yield chain(line, [2.2, 1.6, 1.2, 0.8, 0.4, 0.1]).blended(7)
    yield ellipsoid((0, -70, -40), (8, 7, 5)).blended(12)
    nuchal = [(0, -73, -40), (14, -71, -40), (28, -64, -41), (40, -54, -42), (50, -40, -43)]
    yield chain(nuchal, [1.5, 1.5, 1.5, 1.5, 2.0]).blended(7)


def _base() -> Iterator[ImplicitSolid]:
    # Petrous ridges, clivus and sphenoid body, mastoids, condyles, styloid processes.
    yield rod((20, 6, -45), (54, -16, -44), 7, 10).blended(8)
    yield rod((0, -2, -57), (0, 26, -41), 9, 11, (0.8, 1, 1)).blended(8)
    yield rod((53, -22, -47), (51, -15, -70), 12, 6.5).blended(9)
    yield ellipsoid((18, -13, -63), (6, 11, 6), (0, 0, 25)).blended(4)
    yield rod((41, -7, -55), (37, 4, -82), 3.0, 1.3).blended(4)
    # Pterygoid plates behind the maxilla, greater wing towards the orbit.
    yield rod((13, 36, -44), (15, 33, -76), 4, 2.5, (1.6, 0.6, 1)).blended(4)
    yield rod((22, 30, -38), (44, 44, -30), 7, 5).blended(7)


def orbit(grow: float = 0.0) -> ImplicitSolid:
    """Return the cone of one orbit: rim at the front outside, apex at the back inside."""
    rim, apex = np.array([33.5, 77.0, -31.0]), np.array([17.0, 38.0, -28.0])
    ahead = rim + (rim - apex) * 0.6
    cone = rod(tuple(rim), tuple(apex), 19.3 + grow, 6 + grow, (1.0, 1.0, 1.12))
    mouth = rod(tuple(rim), tuple(ahead), 19.3 + grow, 21 + grow, (1.0, 1.0, 1.12))
    return cone if grow else cone.joined(mouth, 3)


def ear_canal(grow: float = 0.0) -> ImplicitSolid:
    """Return the canal from outside into the petrous ridge."""
    return rod((62, -9, -50), (40, -5, -48), 3.6 + grow, 2.8 + grow)


def _face() -> Iterator[ImplicitSolid]:
    in_front = ImplicitSolid(
        lambda x, y, z: y - (86.0 - 0.012 * x * x) + 0 * z,
        np.array([-90.0, -90.0, -150.0]),
        np.array([90.0, 90.0, 90.0]),
    )
    yield orbit(3.2).within(in_front, 4).blended(5)
    # Maxilla, its frontal process and the nasal bones, ethmoid block between the orbits.
    yield ellipsoid((19, 62, -64), (20, 22, 20)).blended(8)
    yield rod((0, 62, -30), (0, 60, -60), 13, 16, (1, 0.75, 1)).blended(5)
    process = [(9.5, 81, -20), (11, 81.5, -32), (14, 80, -46), (17, 77, -62)]
    yield chain(process, [4, 4.2, 5, 7]).blended(8)
    yield rod((4, 83, -18), (4.2, 90.5, -41), 4.0, 2.9, (0.75, 1, 1)).blended(6)
    a, b = UPPER_ARCH
    angles = np.radians(np.linspace(0, 95, 20))
    path = [(a * np.sin(t), ARCH_Y + b * np.cos(t)) for t in angles]
    yield wall(path, np.full(20, -79.0), np.full(20, 9.5), np.full(20, 5.5), 3.5).blended(6)
    yield ellipsoid((0, 87, -71), (5, 5, 5)).blended(5)


def _cheeks() -> Iterator[ImplicitSolid]:
    yield ellipsoid((45, 64, -56), (13, 11, 11), (0, 0, -35)).blended(7)
    yield rod((44, 66, -58), (28, 66, -70), 8, 7).blended(7)
    yield chain(
        [(49, 66, -14), (52, 63, -28), (51, 63, -42), (48, 64, -54)], [5, 4.3, 5, 8]
    ).blended(6)
    arch = [(52, 58, -55), (60, 47, -54), (64.5, 33, -52)]
    arch += [(65, 18, -50), (61, 4, -48), (55, -8, -45)]
    yield chain(arch, [7.5, 6.2, 5.4, 5.0, 5.4, 7], (1.7, 1.2, 1)).blended(6)


def _openings() -> Iterator[ImplicitSolid]:
    yield orbit().cut(2)
    # Optic canal and superior fissure lead from the apex into the skull.
    yield rod((17, 40, -28), (11, 22, -27), 2.4).cut(2)
    # Nasal cavity: pear-shaped in front, a chamber behind, choanae at the back.
    pear = chain([(0, 100, -43), (2.8, 100, -55), (6.5, 100, -64.5)], [4.0, 5.8, 6.6])
    front = ImplicitSolid(
        lambda x, y, z: pear(x, np.full_like(y, 100.0), z) + 0 * y,
        np.array([-14.0, 66.0, -75.0]),
        np.array([14.0, 110.0, -38.0]),
    )
    slab = block((0, 90, -55), (20, 26, 30), 0, 1)
    yield front.within(slab).cut(2)
    cavity = ellipsoid((6, 52, -52), (8, 23, 17))
    yield cavity.cut(3)
    yield rod((6.5, 62, -60), (6.5, 22, -60), 6, 6.5).cut(3)
    yield ellipsoid((27, 63, -63), (9.5, 13, 10)).cut(2)
    # Septum and conchae.
    yield block((0, 46, -51), (0.9, 18, 19), 0, 0.8).blended(2)
    yield rod((11.5, 64, -62), (11.5, 40, -61), 2.2, 1.8).blended(2)
    yield rod((10.5, 62, -50), (10.5, 40, -50), 2.0, 1.6).blended(2)
    # Palate: concave from below.
    yield ellipsoid((0, 56, -89), (23.5, 27, 13)).cut(4)
    # Infra-orbital and supra-orbital foramina, ear canal, jugular and carotid foramina.
    yield rod((25, 92, -56), (25, 74, -53), 1.8).cut(1)
    yield ear_canal().cut(2)
    yield rod((27, -10, -68), (25, -8, -50), 4).cut(2)
    # Foramen magnum, with its passage up into the braincase.
    yield ellipsoid((0, -24, -60), (15, 17.5, 40)).within(block((0, -24, -60), (30, 30, 22))).cut(3)


def _jaw() -> Iterator[ImplicitSolid]:
    a, b = LOWER_ARCH
    angles = np.radians(np.linspace(0, 95, 20))
    path = [(a * np.sin(t), ARCH_Y + b * np.cos(t)) for t in angles]
    jaw = wall(path, np.full(20, -114.0), np.full(20, 6.5), np.full(20, 4.6), 3)
    # Body: the base of the jaw runs outside the teeth and rises towards the angle.
    turn = np.linspace(0, 1, 24)
    base = _curve([(0, 82), (10, 80.5), (20, 71), (30, 54), (40, 33), (47.5, 12)], turn)
    middle = np.interp(turn, [0, 0.2, 0.35, 0.7, 1], [-126.5, -125, -121.5, -112.5, -101])
    height = np.interp(turn, [0, 0.35, 0.7, 1], [11.0, 11.0, 12.0, 13])
    width = np.interp(turn, [0, 0.3, 0.7, 1], [5.4, 5.2, 5.0, 3.6])
    jaw = jaw.joined(wall(base, middle, height, width, 3.4), 10)
    # Chin.
    jaw = jaw.joined(ellipsoid((0, 85, -130), (9, 5.5, 7.5)), 9)
    jaw = jaw.joined(ellipsoid((11, 81.5, -132.5), (7, 4.5, 4)), 9)
    # Ramus: a plate between front and back border, coronoid process, neck and condyle.
    ramus = wall(
        [(46.5, 30), (48.5, 16), (49.5, 4)], [-88, -88, -87], [24, 24, 22], [3.0, 2.8, 3.0], 2.2
    )
    jaw = jaw.joined(ramus, 6)
    front = [(41, 37, -106), (45, 33, -94), (46.5, 30, -76), (47.5, 26, -55)]
    jaw = jaw.joined(chain(front, [5.2, 4.6, 3.8, 2.2]), 6)
    back = [(48, 14, -107), (49.5, 6, -99), (50, 1, -82), (50, -2.5, -58)]
    jaw = jaw.joined(chain(back, [4.2, 4.4, 4.2, 3.4]), 6)
    jaw = jaw.joined(ellipsoid((50, -3, -55.5), (9.5, 4.4, 4.0), (0, 0, -12)), 4)
    jaw = jaw.without(ellipsoid((48, 11.5, -57), (14, 9.5, 13.5)), 4)
    jaw = jaw.without(rod((30, 78, -121), (24, 62, -121), 1.8), 1)
    yield jaw


def _curve(points: Sequence[tuple[float, float]], at: Floats) -> list[tuple[float, float]]:
    """Return points of a smooth curve through ``points`` (x, y), at shares of its chord length."""
    corners = np.asarray(points, dtype=float)
    walked = np.append(0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    spline = scipy.interpolate.CubicSpline(walked / walked[-1], corners, bc_type="natural")
    return [(float(x), float(y)) for x, y in spline(at)]


def _teeth() -> Iterator[ImplicitSolid]:
    for arch, widths, (z0, z1), depths in (
        (UPPER_ARCH, UPPER_TEETH, UPPER_CROWN_Z, (6.5, 6, 7.5, 8.5, 8.5, 10.5, 10.5)),
        (LOWER_ARCH, LOWER_TEETH, LOWER_CROWN_Z, (5.5, 5.8, 7, 7.5, 8, 10, 10)),
    ):
        angles = np.linspace(0, np.pi / 2 * 1.1, 4000)
        points = np.stack([arch[0] * np.sin(angles), ARCH_Y + arch[1] * np.cos(angles)], axis=1)
        walked = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        middles = np.cumsum(widths) - np.array(widths) / 2
        up = z0 > z1
        for i, (width, depth, at) in enumerate(zip(widths, depths, middles, strict=True)):
            x, y = (float(np.interp(at, walked, points[:, c])) for c in (0, 1))
            t = float(np.interp(at, walked, angles))
            turn = float(np.degrees(np.arctan2(-arch[1] * np.sin(t), arch[0] * np.cos(t))))
            edge = (z1 if up else z0) + (-0.8 if i == 2 else 0.6 * (i > 4)) * (1 if up else -1)
            neck = z0 if up else z1
            root = neck + (7.0 if up else -7.0)
            middle_z, half = (edge + neck) / 2, abs(edge - neck) / 2
            yield block((x, y, middle_z), (width / 2 - 0.45, depth / 2, half), turn, 1.9)
            yield rod((x, y, middle_z), (x, y, root), min(width, depth) / 2 - 1.1, 1.8).blended(0.8)


def _without_crumbs(mesh: trimesh.Trimesh, smallest_mm3: float = 200.0) -> trimesh.Trimesh:
    """Remove closed pieces below this volume: slivers where a cut just touched a surface."""
    import trimesh

    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    signed = np.bincount(labels, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)
    large = mesh.faces[np.abs(signed)[labels] >= smallest_mm3]
    used, faces = np.unique(large, return_inverse=True)
    return surface(mesh.vertices[used], faces.reshape(-1, 3))
