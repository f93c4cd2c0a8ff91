"""The grey phantom's head, about the built-in skull and at its place.

x is to the patient's right, y to the face, z up; the origin is the middle of the skull's bounds.
HU of tissues follow ICRU-44 tissues at 120 kV, rounded; vessels carry a little contrast agent.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from twinct.core.draws import scan_rng
from twinct.specimen.canvas import Canvas
from twinct.specimen.head import MIDDLE, airways, brain_canvas, head_canvas
from twinct.specimen.implicit import ImplicitSolid, Point, ball, block, ellipsoid, rod, rods
from twinct.specimen.organs import Organ
from twinct.specimen.skull import (
    HIGHEST,
    LOWER_CROWN_Z,
    LOWEST,
    UPPER_CROWN_Z,
    skull_canvas,
)

SKULL_STEP_MM = 1.0
SOFT_STEP_MM = 2.0
"""Cells of the lattices of the skull with the airways, and of skin and brain."""

LESION_PLACES: tuple[Point, ...] = ((-36, 2, 22), (34, -42, 18), (-20, -58, 8), (28, 30, 24))
"""Where lesions lie in the brain, on average, in the phantom's frame, mm."""


def head_organs(seed: int) -> tuple[Organ, ...]:
    """Return the organs of the head; ``seed`` moves and sizes the lesions."""
    head, brain, skull, air = _drawn()
    return (
        Organ("skin", 20, (head,), texture_hu=4, wavelength_mm=4),
        Organ("fat", -95, (), "skin", 2.0, texture_hu=12, wavelength_mm=7, edge_mm=1.0),
        Organ(
            "muscle",
            55,
            (),
            "skin",
            4.5,
            gradient=(0.0, -0.05, 0.0),
            texture_hu=9,
            wavelength_mm=4,
            edge_mm=2.5,
        ),
        *_eyes(),
        Organ("airways", -985, (air,), "skin"),
        Organ("cerebrospinal_fluid", 8, (brain,), texture_hu=2, wavelength_mm=6),
        Organ(
            "brain",
            39,
            (),
            "cerebrospinal_fluid",
            2.0,
            gradient=(0.0, 0.01, 0.02),
            shell_mm=9.0,
            core_hu=28.0,
            texture_hu=3,
            wavelength_mm=9,
            edge_mm=2.0,
        ),
        Organ("ventricles", 7, _both(ellipsoid((9, 6, 19), (5, 24, 8), (-12, 0, 0))), edge_mm=1.0),
        *_lesions(seed),
        Organ("cerebral_vessels", 190, _vessels(), "cerebrospinal_fluid", edge_mm=0.6),
        Organ(
            "skull",
            1450,
            (skull,),
            shell_mm=1.8,
            core_hu=520.0,
            texture_hu=170,
            wavelength_mm=1.6,
        ),
        Organ(
            "teeth",
            2500,
            _crowns(),
            "skull",
            shell_mm=1.5,
            core_hu=1700.0,
            texture_hu=40,
            wavelength_mm=3,
        ),
    )


@lru_cache(maxsize=1)
def _drawn() -> tuple[ImplicitSolid, ImplicitSolid, ImplicitSolid, ImplicitSolid]:
    """Return skin, brain, skull and airways."""
    air = Canvas(SKULL_STEP_MM, np.subtract(LOWEST, (0, 0, 20)), np.add(HIGHEST, (0, 20, 0)))
    air.draw(*(airway.blended(2) for airway in airways()))
    skull = skull_canvas(SKULL_STEP_MM, margin_mm=2 * SKULL_STEP_MM)
    canvases = head_canvas(SOFT_STEP_MM), brain_canvas(SOFT_STEP_MM), skull, air
    skin, brain, bone, hollows = (canvas.solid(MIDDLE) for canvas in canvases)
    return skin, brain, bone, hollows


def _design(x: float, y: float, z: float) -> Point:
    """Return a point of the skull's design frame in the phantom's frame."""
    return x - MIDDLE[0], y - MIDDLE[1], z - MIDDLE[2]


def _both(solid: ImplicitSolid) -> tuple[ImplicitSolid, ImplicitSolid]:
    """Return a solid and its mirror image."""
    return solid, solid.mirrored()


def _eyes() -> tuple[Organ, ...]:
    fat = rod((29, 66, 5), (14, 36, 6), 17, 5)
    nerve = rod((28, 56, 5), (14, 34, 6), 2.5, 2.0)
    return (
        Organ("orbital_fat", -85, _both(fat), "skin", 5.0, texture_hu=8, wavelength_mm=5),
        Organ("optic_nerve", 35, _both(nerve)),
        Organ("eye", 10, _both(ball((31, 68.3, 5), 12)), shell_mm=1.0, core_hu=6.0),
        Organ("eye_lens", 75, _both(ellipsoid((31, 75.3, 5), (4.5, 2, 4.5)))),
    )


def _lesions(seed: int) -> tuple[Organ, ...]:
    """Return a bleeding, an infarct, a tumour with a soft core, and a low-contrast spot."""
    rng = scan_rng(seed, "phantom lesions of the head")
    places = np.array(LESION_PLACES) + rng.uniform(-6, 6, (4, 3))
    radii = np.array([7.0, 10.0, 8.0, 5.0])[:, None] * rng.uniform(0.8, 1.2, (4, 3))
    bodies = [
        ellipsoid(tuple(p), tuple(r)) for p, r in zip(places.tolist(), radii.tolist(), strict=True)
    ]
    return (
        Organ("lesion_bleeding", 66, (bodies[0],), texture_hu=3, wavelength_mm=4, edge_mm=1.5),
        Organ("lesion_infarct", 20, (bodies[1],), edge_mm=6.0),
        Organ("lesion_tumour", 52, (bodies[2],), shell_mm=4.0, core_hu=18.0, edge_mm=1.5),
        Organ("lesion_spot", 46, (bodies[3],), edge_mm=1.0),
    )


def _vessels() -> tuple[ImplicitSolid, ...]:
    """Return the basilar artery, the middle and front cerebral arteries, and the upper sinus."""
    arcs = np.radians(np.linspace(-10, 170, 13))
    sinus = [(0.0, float(-10 + 82 * np.cos(t)), float(38 + 58 * np.sin(t))) for t in arcs]
    middle: list[Point] = [(5, 22, 6), (18, 24, 4), (32, 18, 8), (44, 6, 18), (52, -12, 30)]
    front: list[Point] = [(2, 26, 6), (2, 46, 14), (2, 54, 34), (2, 40, 56)]
    paired = [
        *rods(middle, [1.6, 1.5, 1.3, 1.0, 0.7]),
        *rods(front, [1.2, 1.1, 0.9, 0.7]),
    ]
    return (
        rod((0, 4, -36), (0, 14, 0), 1.7),
        *rods(sinus, [3.5] * len(sinus)),
        *(twin for solid in paired for twin in _both(solid)),
    )


def _crowns() -> tuple[ImplicitSolid, ...]:
    """Return the slabs in which the skull is teeth."""
    slabs: list[ImplicitSolid] = []
    for z0, z1 in (UPPER_CROWN_Z, LOWER_CROWN_Z):
        half = abs(z1 - z0) / 2
        slabs.append(block(_design(0, 62, (z0 + z1) / 2), (42, 32, half), rounding=0.5))
    return tuple(slabs)
