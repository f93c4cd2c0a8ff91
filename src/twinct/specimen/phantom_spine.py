"""Spine and ribs of the grey phantom's trunk: vertebrae T1 to L4, discs, cord, ribs, breastbone."""

from __future__ import annotations

import numpy as np

from twinct.specimen.implicit import ImplicitSolid, Point, block, ellipsoid, rod, rods
from twinct.specimen.organs import Organ

LOWEST_MM = -196.0
"""Height of the middle of the lowest vertebra, L4."""
LEVELS = ("L4", "L3", "L2", "L1", *(f"T{n}" for n in range(12, 0, -1)))
"""Vertebrae, from below."""
CANAL_BACK_MM = 27.0
"""Distance of the spinal canal behind the middle of a vertebral body."""


def _heights() -> tuple[list[float], list[float]]:
    """Return the middles of the vertebrae, and their spacings, mm."""
    spacing = np.interp(np.arange(len(LEVELS)), [0, 3, 15], [34.0, 31.0, 21.0])
    middles = LOWEST_MM + np.append(0.0, np.cumsum((spacing[1:] + spacing[:-1]) / 2))
    return middles.tolist(), spacing.tolist()


def _middle_y(z: float) -> float:
    """Return y of the vertebral bodies: hollow back below, rounded back above."""
    return (
        -52.0
        + 8.0 * float(np.exp(-(((z + 170) / 80) ** 2)))
        - 9.0 * float(np.exp(-(((z - 60) / 100) ** 2)))
    )


def spine() -> tuple[Organ, ...]:
    """Return cord, discs and vertebrae."""
    middles, spacings = _heights()
    line: list[Point] = [(0.0, _middle_y(z) - CANAL_BACK_MM, z) for z in range(-260, 261, 20)]
    count = len(line)
    discs, bones = list[ImplicitSolid](), list[Organ]()
    for level, z, spacing in zip(LEVELS, middles, spacings, strict=True):
        size = spacing / 31.0
        y = _middle_y(z)
        discs.append(ellipsoid((0, y, z - spacing / 2), (23 * size, 17 * size, 5.5 * size)))
        solids = tuple(solid.moved((0, y, z)) for solid in _vertebra(size))
        bones.append(
            Organ(
                f"vertebrae_{level}",
                760,
                solids,
                "fat",
                3.0,
                shell_mm=2.2,
                core_hu=230.0,
                texture_hu=95,
                wavelength_mm=1.8,
                gradient=(0.0, 0.0, 2.0 if level.startswith("L") else 0.0),
                centre=(0.0, y, z),
            )
        )
    return (
        Organ("spinal_canal", 12, rods(line, [8.5] * count), "fat", 5.0, edge_mm=1.5),
        Organ("spinal_cord", 40, rods(line, [5.0] * count), "fat", 5.0, edge_mm=1.5),
        Organ("disc", 85, tuple(discs), "fat", 5.0, shell_mm=4, core_hu=65, edge_mm=1.0),
        *bones,
    )


def _vertebra(size: float) -> tuple[ImplicitSolid, ...]:
    """Return a vertebra about the middle of its body; ``size`` 1 is L1."""
    s, back = size, -CANAL_BACK_MM
    body = rod((0, 0, -11.5 * s), (0, 0, 11.5 * s), 20.5 * s, 20.5 * s, (1, 1.3, 1))
    slab = block((0, 0, 0), (26 * s, 20 * s, 13 * s), rounding=2.5).keep(2.5)
    waist = [ellipsoid((x * 27 * s, 0, 0), (6 * s, 14 * s, 7 * s)).cut(4) for x in (-1, 1)]
    arch = list[ImplicitSolid]()
    for x in (-1, 1):
        arch += [
            rod((x * 14 * s, -9 * s, 3 * s), (x * 15 * s, back, 2 * s), 5.2 * s, 5.0 * s),
            rod((x * 15 * s, back, 2 * s), (0, back - 14 * s, -3 * s), 4.6 * s, 4.4 * s),
            rod((x * 15 * s, back, 2 * s), (x * 36 * s, back - 6, 4 * s), 4.4 * s, 3.2 * s),
            rod((x * 15 * s, back - 2, -8 * s), (x * 15 * s, back - 2, 13 * s), 5 * s, 5 * s),
        ]
    spinous = rod(
        (0, back - 13 * s, -3 * s), (0, back - 32 * s, -12 * s), 4.5 * s, 5 * s, (1.5, 1, 1)
    )
    canal = rod((0, back + 1, -40), (0, back + 1, 40), 9.5).cut(2)
    return (body, slab, *waist, *(solid.blended(4) for solid in arch), spinous.blended(4), canal)


def ribs() -> tuple[Organ, ...]:
    """Return twelve pairs of ribs, their cartilage, breastbone and collarbones."""
    middles, _ = _heights()
    height = dict(zip(LEVELS, middles, strict=True))
    bones, cartilage = list[Organ](), list[ImplicitSolid]()
    for number in range(1, 13):
        level = height[f"T{number}"]
        for side, name in ((1, "right"), (-1, "left")):
            path = _rib_path(number, level, side)
            radii = [float(r) for r in np.interp(np.linspace(0, 1, len(path)), [0, 1], [4.4, 5.2])]
            bones.append(
                Organ(
                    f"rib_{name}_{number}",
                    820,
                    rods(path, radii, (1.0, 1.0, 0.85)),
                    shell_mm=1.3,
                    core_hu=260.0,
                    texture_hu=80,
                    wavelength_mm=1.8,
                )
            )
            if number <= 9:
                x, y, z = path[-1]
                front = (side * 12.0, _front_y(12.0), max(z + 18.0 * number / 9, -20.0))
                cartilage += rods([(x, y, z), front], [5.4, 5.0], (1.0, 1.0, 0.85))
    breastbone = rods([(0, 86, -20), (0, 88, 60), (0, 84, 112)], [15, 16, 22], (1, 3, 1))
    collar = [
        rods([(s * 20, 74, 128), (s * 70, 62, 140), (s * 120, 30, 150)], [7, 6, 7]) for s in (1, -1)
    ]
    bone = {"shell_mm": 1.3, "core_hu": 200.0, "texture_hu": 70, "wavelength_mm": 1.8}
    return (
        Organ("costal_cartilage", 120, tuple(cartilage), "fat", 4.0, edge_mm=1.5),
        *bones,
        Organ("sternum", 620, breastbone, "fat", 3.0, **bone),
        Organ("clavicle", 900, tuple(s for pair in collar for s in pair), "fat", 4.0, **bone),
    )


def _front_y(x: float) -> float:
    """Return y of the breastbone's plane beside the middle."""
    return 88.0 - 0.004 * x * x


def _rib_path(number: int, level: float, side: int) -> list[Point]:
    """Return a rib's corners, from its vertebra around the chest; the lower ones end earlier."""
    wide = float(np.interp(number, [1, 3, 8, 12], [74, 112, 138, 128]))
    deep = float(np.interp(number, [1, 3, 8, 12], [56, 76, 92, 86]))
    end = float(np.interp(number, [1, 7, 10, 12], [155, 148, 125, 75]))
    fall = float(np.interp(number, [1, 7, 12], [34, 82, 60]))
    path: list[Point] = [(side * 17.0, _middle_y(level) - 14.0, level + 4.0)]
    for angle in np.linspace(22, end, 11):
        turn = np.radians(angle)
        x, y = wide * np.sin(turn), -deep * np.cos(turn) + 2.0
        path.append((side * float(x), float(y), level + 4.0 - fall * float(angle / end) ** 1.5))
    return path
