"""Pixel lattices."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Panel

PANEL = Panel(rows=12, columns=17, pitch_u=2.0, pitch_v=3.0)


def test_divided_pixels_cover_the_same_area() -> None:
    fine = PANEL.divided(4)
    assert fine == Panel(48, 68, 0.5, 0.75)
    assert fine.size_mm == PANEL.size_mm
    assert fine.binned(4, 4) == PANEL


def test_binning_leaves_out_what_fills_no_pixel() -> None:
    assert PANEL.binned(5, 4) == Panel(2, 4, 8.0, 15.0)
    with pytest.raises(ValueError, match="no pixels"):
        PANEL.binned(13, 1)


def test_middle_and_first_pixel() -> None:
    assert PANEL.middle == (8.0, 5.5)
    assert PANEL.first_pixel_mm == (-16.0, -16.5)
    np.testing.assert_array_equal(PANEL.mm_from_pixel @ [3, 2, 1], [-16 + 3 * 2, -16.5 + 2 * 3, 1])
    np.testing.assert_array_equal(PANEL.mm_from_pixel @ [*PANEL.middle, 1], [0, 0, 1])
