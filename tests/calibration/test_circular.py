"""Circular scans: the numbers of the whole scan are found from projections alone."""

from __future__ import annotations

import numpy as np
import pytest
from soft_balls import circle_of, images

from twinct.calibration import (
    CircularPrior,
    aligned,
    circle_numbers,
    circular,
    circular_consistent,
)
from twinct.core.errors import InputError

POINTS = 15.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])
NUMBERS = {
    "sod_mm": 201.0,
    "sdd_mm": 402.0,
    "panel_offset_mm": (5.0, -2.0),
    "panel_roll_deg": 0.4,
    "panel_tilt_deg": -0.5,
    "panel_slant_deg": 0.6,
}


def test_numbers_are_those_of_the_import() -> None:
    found = circle_numbers(circle_of(**NUMBERS))._asdict()
    for key, value in NUMBERS.items():
        assert found[key] == pytest.approx(value, abs=1e-9), key


@pytest.mark.parametrize("turned", [False, True])
def test_axis_roll_and_the_rest_are_found(turned) -> None:
    executed, believed = circle_of(**NUMBERS), circle_of(sod_mm=200.0, sdd_mm=400.0)
    if turned:
        executed, believed = executed[::-1], believed[::-1]
    found = circular_consistent(images(executed), believed)
    truth = circle_numbers(executed)
    assert found.before.axis_px == pytest.approx(0, abs=1e-9)
    assert found.after.axis_px == pytest.approx(truth.axis_px, abs=0.1)
    assert found.after.panel_roll_deg == pytest.approx(truth.panel_roll_deg, abs=0.03)
    assert aligned(believed, executed, POINTS).after_px > 1
    assert aligned(found.geometry, executed, POINTS).after_px < 0.1
    assert found.residuals[1] < 0.3 * found.residuals[0]
    assert found.after.sod_mm == found.before.sod_mm


@pytest.mark.tutorial
def test_what_is_not_determined_is_named_and_stays() -> None:
    """In a narrow cone, neither tilt nor slant is seen."""
    narrow = {"sod_mm": 4000.0, "sdd_mm": 8000.0}
    executed = circle_of(**narrow, panel_offset_mm=(5.0, 0.0), panel_roll_deg=0.4)
    p = images(executed)
    p += np.random.default_rng(0).normal(0, 0.01, p.shape).astype(np.float32)
    found = circular_consistent(p, circle_of(**narrow), CircularPrior(turn_deg=0.5))
    named = {part for one in found.undetermined for part in one.parts}
    assert {"tilt", "slant"} <= named
    assert not {"axis_offset", "roll"} & {one.parts[0] for one in found.undetermined}
    assert found.after.axis_px == pytest.approx(circle_numbers(executed).axis_px, abs=0.1)
    assert found.after.panel_tilt_deg == pytest.approx(0, abs=0.3)


def test_noise_is_no_knowledge() -> None:
    """Slopes of noise determine nothing, and the numbers stay within their spreads."""
    executed, believed = circle_of(**NUMBERS), circle_of(sod_mm=200.0, sdd_mm=400.0)
    clean = images(executed)
    noise = np.random.default_rng(5).normal(0, 1, clean.shape).astype(np.float32)
    spreads = []
    for sigma in (0.0, 0.1):
        found = circular_consistent(clean + np.float32(sigma) * noise, believed)
        spreads.append(found.deviation)
    truth = circle_numbers(executed)
    off = [
        (found.after.axis_px - truth.axis_px) * believed.panel.pitch_u,
        (found.after.height_px - truth.height_px) * believed.panel.pitch_v,
        found.after.sdd_mm - truth.sdd_mm * found.after.sod_mm / truth.sod_mm,
        np.radians(found.after.panel_roll_deg - truth.panel_roll_deg),
    ]
    pulls = np.abs(off) / found.deviation[[0, 1, 2, 5]]
    assert (spreads[1] >= spreads[0]).all() and pulls.max() < 4, pulls


def test_more_views_count_where_few_are_not_precise(monkeypatch) -> None:
    executed, believed = circle_of(**NUMBERS), circle_of(sod_mm=200.0, sdd_mm=400.0)
    p = images(executed)
    p += np.random.default_rng(2).normal(0, 0.05, p.shape).astype(np.float32)
    spreads: dict[tuple[int, ...], float] = {}
    for most in ((12,), (12, 24)):
        monkeypatch.setattr(circular, "MOST_VIEWS", most)
        found = circular_consistent(p, believed)
        spreads[most] = found.deviation[5]
    assert spreads[12, 24] < 0.85 * spreads[12,], spreads


def test_no_circle_is_refused() -> None:
    views = circle_of()
    with pytest.raises(InputError, match="needs a circular scan of at least 3 views, not 2"):
        circular_consistent(np.zeros((2, *views.panel.shape), np.float32), views[:2])
