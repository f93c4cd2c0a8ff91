"""The grey phantom's trunk: chest and upper belly of an adult, from shoulders to hips.

x is to the patient's right, y to the front, z up; the origin lies in the chest's middle, at the
height of the heart. HU of tissues follow ICRU-44 tissues at 120 kV, rounded; vessels carry contrast
agent.
"""

from __future__ import annotations

import numpy as np

from twinct.core.draws import scan_rng
from twinct.specimen.implicit import ImplicitSolid, Point, ball, block, ellipsoid, rod, rods
from twinct.specimen.organs import Organ
from twinct.specimen.phantom_spine import ribs, spine

HALF_LENGTH_MM = 235.0
"""Half length of the trunk along z."""
CONTRAST_HU = 180.0


def trunk_organs(seed: int) -> tuple[Organ, ...]:
    """Return the organs of the trunk; ``seed`` selects lesions and branches of vessels."""
    return (*_wall(), *_chest(seed), *_belly(seed), *spine(), *ribs(), *_bone_lesions(seed))


def _wall() -> tuple[Organ, ...]:
    """Return skin, fat, muscle, and the cavity that the organs lie in."""
    ends = block((0, 0, 0), (180, 130, HALF_LENGTH_MM), rounding=25).keep(20)
    skin = rod((0, 0, -400), (0, 0, 400), 165, 165, (1, 1.45, 1))
    muscle = rod((0, -3, -400), (0, -1, 400), 149, 152, (1, 1.45, 1))
    cavity = rod((0, 6, -260), (0, 2, 190), 138, 108, (1, 1.5, 1))
    back = [rod((x, -76, -230), (x * 0.8, -80, 230), 25, 22, (1, 1.25, 1)) for x in (-36, 36)]
    return (
        Organ("skin", 25, (skin, ends), texture_hu=4, wavelength_mm=4),
        Organ("fat", -100, (), "skin", 2.2, texture_hu=12, wavelength_mm=9, edge_mm=1.0),
        Organ("muscle", 56, (muscle,), "fat", 4.0, texture_hu=10, wavelength_mm=5, edge_mm=2.5),
        Organ("cavity", -60, (cavity,), "muscle", 2.0, texture_hu=30, wavelength_mm=16, edge_mm=4),
        Organ("back_muscle", 60, tuple(back), "fat", 3, texture_hu=9, wavelength_mm=4, edge_mm=3),
    )


def _chest(seed: int) -> tuple[Organ, ...]:
    """Return lungs with branches, nodules and airways, heart, and great vessels."""
    dome = (
        ellipsoid((58, 8, -128), (84, 88, 118)).cut(4),
        ellipsoid((-58, 8, -140), (80, 84, 112)).cut(4),
    )
    middle = rod((0, 15, -220), (0, -5, 230), 30, 22, (1, 0.6, 1)).cut(10)
    right = (ellipsoid((68, -2, 55), (58, 84, 165)), *dome, middle)
    left = (ellipsoid((-68, -2, 55), (56, 82, 165)), *dome, middle)
    rng = scan_rng(seed, "phantom lesions of the lungs")
    spots = rng.uniform((-1, -30, 20), (1, 40, 120), (4, 3)) * (22, 1, 1) + (62, 0, 0)
    spots[1::2, 0] *= -1
    radii = rng.uniform(3, 9, 4).tolist()
    nodules = [ball(tuple(p), r) for p, r in zip(spots.tolist(), radii, strict=True)]
    air = [
        *rods([(0, 2, 260), (0, -8, 100), (28, -12, 66), (48, -14, 40)], [8.5, 8.5, 6, 3.5]),
        *rods([(0, -8, 100), (-30, -14, 62), (-50, -16, 36)], [8.5, 5.5, 3.2]),
    ]
    walls = [
        *rods([(0, 2, 260), (0, -8, 100), (28, -12, 66), (48, -14, 40)], [10, 10, 7.2, 4.4]),
        *rods([(0, -8, 100), (-30, -14, 62), (-50, -16, 36)], [10, 6.8, 4.2]),
    ]
    lung = {
        "gradient": (0.0, -0.7, 0.0),
        "texture_hu": 28,
        "wavelength_mm": 6,
        "edge_mm": 1.0,
    }
    trees = (
        ("lung_right", _tree((24, -6, 58), 1, seed)),
        ("lung_left", _tree((-26, -8, 54), -1, seed)),
    )
    vessels = [
        Organ("lung_vessels", 40, tree, host, shell_mm=1.0, core_hu=CONTRAST_HU, edge_mm=0.6)
        for host, tree in trees
    ]
    return (
        Organ("lung_right", -845, right, "cavity", 5, **lung),
        Organ("lung_left", -845, left, "cavity", 5, **lung),
        *vessels,
        Organ("lung_nodule", 35, tuple(nodules), "cavity", 5, edge_mm=1.5),
        *_heart(),
        Organ("airway_wall", 40, tuple(walls), "muscle"),
        Organ("airways", -985, tuple(air), "muscle"),
    )


def _heart() -> tuple[Organ, ...]:
    """Return the heart in its fat, its chambers, and the great vessels."""
    rim = (
        ellipsoid((-22, 32, 2), (56, 44, 58), (0, 0, -25)),
        ellipsoid((8, 18, 30), (34, 32, 38)).blended(15),
    )
    flesh = ellipsoid((-22, 32, 2), (51, 39, 53), (0, 0, -25)), ellipsoid((8, 18, 30), (30, 28, 34))
    chambers = (
        ellipsoid((-38, 26, -6), (24, 18, 34), (15, 20, -20)),
        ellipsoid((2, 50, -6), (24, 14, 32), (0, -20, -10)),
        ellipsoid((18, 26, 32), (16, 18, 20)),
        ellipsoid((-8, 2, 34), (20, 13, 18)),
    )
    aorta: list[Point] = [(-6, 24, 28), (-2, 28, 60), (-6, 18, 92), (-14, -4, 106)]
    aorta += [(-20, -28, 98), (-22, -40, 70), (-20, -42, -40), (-8, -36, -120), (-4, -34, -260)]
    hollow: list[Point] = [(26, -20, -260), (26, -16, -60), (24, 12, -10), (20, 20, 40)]
    hollow += [(22, 18, 110), (26, 20, 200)]
    aorta_radii = [15, 15, 13.5, 13, 12.5, 12, 11.5, 10, 9]
    calcified = [(-26.0, -47.0, 60.0), (-25.5, -46.0, -10.0), (-10.0, -28.0, -112.0)]
    return (
        Organ("heart_fat", -90, rim, "cavity", 3, texture_hu=14, wavelength_mm=8, edge_mm=2),
        Organ("heart", 95, flesh, "cavity", 4, texture_hu=6, wavelength_mm=8, edge_mm=2),
        Organ("heart_chambers", CONTRAST_HU, chambers, edge_mm=2),
        Organ("vena_cava", 130, rods(hollow, [11, 11.5, 11, 10, 9.5, 9]), "muscle", edge_mm=0.8),
        Organ("aorta", 60, rods(aorta, aorta_radii), "muscle", shell_mm=2, core_hu=CONTRAST_HU),
        Organ("calcification", 520, tuple(ball(p, 2.2) for p in calcified), edge_mm=1.0),
    )


def _belly(seed: int) -> tuple[Organ, ...]:
    """Return liver with branches and lesions, spleen, stomach, kidneys, and bowel."""
    liver = (
        ellipsoid((62, 6, -92), (74, 76, 78)),
        ellipsoid((-14, 40, -74), (56, 34, 34)).blended(20),
    )
    flesh = {"texture_hu": 7, "wavelength_mm": 8, "edge_mm": 1.5}
    rng = scan_rng(seed, "phantom lesions of the liver")
    spots = np.array([[70, 10, -60], [90, -20, -100], [40, 40, -95], [60, -10, -130]], float)
    spots += rng.uniform(-8, 8, spots.shape)
    lesions = [ball(tuple(p), r) for p, r in zip(spots.tolist(), (9, 6, 4, 12), strict=True)]
    kidneys = ellipsoid((56, -48, -150), (30, 24, 52)), ellipsoid((-56, -50, -136), (30, 24, 52))
    pelvis = ellipsoid((44, -46, -150), (14, 10, 28)), ellipsoid((-44, -48, -136), (14, 10, 28))
    bowel: list[Point] = [(70, 40, -195), (30, 55, -180), (-20, 50, -200), (-75, 40, -175)]
    return (
        Organ("bowel", 30, rods(bowel, [26, 24, 26, 24]), "cavity", 6, shell_mm=4, core_hu=10),
        Organ("liver", 100, liver, "cavity", 5, (0.05, 0.02, 0.1), (62, 6, -92), **flesh),
        Organ("liver_vessels", 160, _tree((20, 0, -96), 1, seed + 1), "liver", 3, edge_mm=1),
        Organ("liver_lesion", 30, tuple(lesions), "liver", 2, shell_mm=5, core_hu=12, edge_mm=2.5),
        Organ(
            "spleen",
            112,
            (ellipsoid((-88, -36, -84), (38, 30, 54), (0, 20, 0)),),
            "cavity",
            5,
            **flesh,
        ),
        Organ("stomach", 30, (ellipsoid((-52, 30, -92), (44, 42, 56), (0, 25, 0)),), "cavity", 7),
        Organ("stomach_gas", -960, (ellipsoid((-56, 48, -88), (26, 16, 32)),), "stomach", 4),
        Organ("kidney", 175, kidneys, shell_mm=14, core_hu=110, edge_mm=1.5),
        Organ("kidney_pelvis", 8, pelvis, edge_mm=5),
    )


def _bone_lesions(seed: int) -> tuple[Organ, ...]:
    """Return a lytic and a dense focus in the vertebrae L1 and T10."""
    shift = scan_rng(seed, "phantom lesions of the spine").uniform(-4, 4, 3)
    lytic, dense = np.array([6, -52, -96]) + shift, np.array([-6, -54, -12]) - shift
    return (
        Organ("lesion_lytic", 55, (ball(tuple(lytic.tolist()), 6.5),), edge_mm=3),
        Organ("lesion_dense", 900, (ball(tuple(dense.tolist()), 4.0),), edge_mm=4),
    )


def _tree(root: Point, side: int, seed: int, generations: int = 5) -> tuple[ImplicitSolid, ...]:
    """Return a tree of vessels that forks from ``root`` to the side, forward and backward.

    Radii follow Murray's law: the cubes of both branches add up to that of their stem.
    """
    rng = scan_rng(seed, f"phantom branches {side} {root}")
    solids: list[ImplicitSolid] = []
    tips = [(np.array(root, float), np.array([0.8 * side, 0.0, 0.0]), 6.0)]
    for generation in range(generations):
        grown: list[tuple[np.ndarray, np.ndarray, float]] = []
        for start, along, radius in tips:
            for share in (0.6, 0.4) if generation else (0.4, 0.35, 0.25):
                way = along + rng.normal(0, 0.55, 3)
                way /= np.linalg.norm(way)
                thin = radius * share ** (1 / 3)
                end = start + way * rng.uniform(5.5, 8.5) * thin
                solids.append(rod(tuple(start.tolist()), tuple(end.tolist()), thin, thin * 0.85))
                grown.append((end, way, thin * 0.85))
        tips = grown
    return tuple(solids)
