"""Balls that fade out at their surface, whose line integrals are exact, and circles about them."""

from __future__ import annotations

from typing import Any

import numpy as np

from twinct.geometry import Panel, ScanGeometry
from twinct.measured.circle import Circle
from twinct.measured.views import ImageFacts

# Balls of density mu (1 - r^2/R^2)^2 about their centres, none on an axis.
_DRAW = np.random.default_rng(1)
CENTRES = _DRAW.uniform(-30, 30, (8, 3))
RADII = _DRAW.uniform(14, 28, 8)
MU = _DRAW.uniform(0.01, 0.04, 8)


def images(geometry: ScanGeometry) -> np.ndarray:
    """Line integrals: a ray at d R from a centre sees mu R 16/15 (1 - d^2)^(5/2)."""
    found = np.zeros((len(geometry), *geometry.panel.shape))
    for view, source in enumerate(geometry.source):
        ray = geometry.pixel_centres(view) - source
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        for centre, radius, mu in zip(CENTRES, RADII, MU, strict=True):
            to_ball = centre - source
            inside = 1 - (to_ball @ to_ball - (ray @ to_ball) ** 2) / radius**2
            found[view] += mu * radius * 16 / 15 * np.maximum(inside, 0) ** 2.5
    return found.astype(np.float32)


PANEL = Panel(96, 104, 2.4, 2.4)


def circle_of(views: int = 24, panel: Panel = PANEL, **keys: Any) -> ScanGeometry:
    """Return a circular scan, in the words of an import."""
    section = Circle.model_validate(
        {
            "kind": "circle",
            "sod_mm": 200.0,
            "sdd_mm": 400.0,
            "pitch_mm": (panel.pitch_u, panel.pitch_v),
            "angles": {"step": 360 / views},
            "rotates": "object",
            "direction": "counterclockwise",
            **keys,
        }
    )
    return section.views(ImageFacts(views, panel.rows, panel.columns)).geometry
