"""Few rows: a slice finds the axis, against ellipses whose line integrals are known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twinct.calibration import circle_found
from twinct.core.errors import CalibrationError
from twinct.geometry import Panel, ScanGeometry

OFFSET_PX = 6.3
PHOTONS = 2e4
CLOSE_PX = 0.1
"""Precision below which a volume hardly suffers, as in ``circular.FINE_PX``."""

BODY = (0.02, (2.0, -3.0), (18.0, 15.0), 0.3)
PARTS = (
    BODY,
    (0.02, (7.0, 2.0), (4.0, 2.0), 0.5),
    (-0.015, (-6.0, 4.0), (3.0, 5.0), 1.0),
    (0.03, (1.0, -10.0), (1.5, 2.5), 2.0),
)
"""Attenuation in 1/mm, centre and half axes in mm, and turn of ellipses: asymmetric."""


def views(number: int, arc_deg: float, sod_mm: float, sdd_mm: float, columns: int) -> ScanGeometry:
    """Return a panel of two rows whose pixels are 0.5 mm at the axis."""
    angle = np.radians(arc_deg) * np.arange(number) / number
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    u = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    pitch = 0.5 * sdd_mm / sod_mm
    panel = Panel(2, columns, pitch, pitch)
    return ScanGeometry(sod_mm * out, (sod_mm - sdd_mm) * out, u, np.cross(out, u), panel)


def images(geometry: ScanGeometry, parts: tuple = PARTS) -> np.ndarray:
    """Return noisy line integrals of cylinders along the axis."""
    p = np.zeros((len(geometry), *geometry.panel.shape))
    for view, source in enumerate(geometry.source):
        way = (geometry.pixel_centres(view) - source)[..., :2]
        way /= np.linalg.norm(way, axis=-1, keepdims=True)
        for mu, centre, axes, turn in parts:
            c, s = np.cos(turn), np.sin(turn)
            inward = np.array([[c, s], [-s, c]]) / np.array(axes)[:, None]
            o, d = inward @ (source[:2] - centre), way @ inward.T
            a, b = (d**2).sum(-1), d @ o
            p[view] += mu * 2 * np.sqrt(np.maximum(b**2 - a * (o @ o - 1), 0)) / a
    photons = np.random.default_rng(0).poisson(PHOTONS * np.exp(-p))
    return -np.log(np.maximum(photons, 0.5) / PHOTONS).astype(np.float32)


def shifted(believed: ScanGeometry) -> ScanGeometry:
    """Return a geometry whose panel lies beside the believed place."""
    by = OFFSET_PX * believed.panel.pitch_u
    return replace(believed, detector=believed.detector + by * believed.u)


@pytest.mark.parametrize(
    "believed",
    [
        views(70, 180, 1e5, 100010, 96),
        views(70, 360, 150, 300, 96),
        views(70, 230, 150, 300, 96),
        views(70, 360, 150, 300, 48),
    ],
    ids=["parallel", "fan", "short scan", "cut off"],
)
def test_two_rows_tell_the_axis(believed) -> None:
    found = circle_found(images(shifted(believed)), believed)
    pitch = believed.panel.pitch_u
    assert found.change[0] / pitch == pytest.approx(OFFSET_PX, abs=CLOSE_PX)
    assert found.deviation[0] / pitch < CLOSE_PX
    assert found.residuals[1] < 0.5 * found.residuals[0]
    assert {part for one in found.undetermined for part in one.parts} == {
        "height",
        "sdd",
        "tilt",
        "slant",
        "roll",
    }
    np.testing.assert_allclose(
        found.geometry.detector, shifted(believed).detector, atol=CLOSE_PX * pitch
    )


def test_an_axis_that_leans_in_the_world_is_found_alike() -> None:
    """The slice lies in the plane of the circle, wherever that is."""
    from twinct.geometry import Pose

    believed = views(70, 360, 150, 300, 96)
    p = images(shifted(believed))
    leaning = Pose.from_euler((3, -8, 5), (90, 20, 0)) @ believed
    found = circle_found(p, leaning)
    assert found.change[0] / believed.panel.pitch_u == pytest.approx(OFFSET_PX, abs=CLOSE_PX)


def test_less_than_half_a_turn_is_refused() -> None:
    believed = views(60, 120, 150, 300, 96)
    with pytest.raises(CalibrationError, match="views over 120 deg do not tell the axis"):
        circle_found(images(believed), believed)


def test_views_without_an_object_leave_the_axis_open() -> None:
    believed = views(60, 180, 1e5, 100010, 48)
    p = 0.05 * np.random.default_rng(1).standard_normal((60, 2, 48)).astype(np.float32)
    with pytest.raises(CalibrationError, match="parts of them move the panel"):
        circle_found(p, believed)


def test_few_views_are_refused() -> None:
    believed = views(8, 360, 150, 300, 96)
    with pytest.raises(CalibrationError, match="8 views do not tell the axis"):
        circle_found(images(believed), believed)
