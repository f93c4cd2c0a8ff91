"""Rows and columns that differ, flicker, or begin a tile: named, and evened by their air."""

from __future__ import annotations

import re

import numpy as np
import pytest
from soft_balls import circle_of, images

FREE = 30000.0
CLEAN = np.exp(-images(circle_of(36)))
PHOTONS = 20000.0


@pytest.fixture
def told_of(imported, stored, circle):
    """A function that imports views of a noisy scan, and returns transmissions and doubts."""

    def run(views, **keys):
        geometry = circle | {"sod_mm": 200.0, "sdd_mm": 400.0, "pitch_mm": 2.4}
        geometry["angles"] = {"step": 360 / len(views)}
        section = stored(np.float32(FREE * views), "intensities", white=FREE, **keys)
        scan, told = imported({"images": section, "geometry": geometry})
        return scan.transmission, "\n".join(told.doubts)

    return run


@pytest.fixture(scope="module")
def noisy():
    return np.random.default_rng(8).poisson(CLEAN * PHOTONS) / PHOTONS


def error(found, right):
    return float(np.sqrt(np.mean(np.log(found / right) ** 2)))


@pytest.mark.parametrize("along", ["rows", "columns"])
def test_a_clean_scan_has_no_odd_lines(along, noisy, told_of):
    right, doubts = told_of(noisy)
    assert not doubts
    evened, _ = told_of(noisy, lines={"along": along})
    assert (evened == right).mean() > 0.999


def test_a_row_that_differs_in_all_views_is_named_and_evened(noisy, told_of):
    right, _ = told_of(noisy)
    views = noisy.copy()
    views[:, 40] *= 1.05
    _, doubts = told_of(views)
    assert "air of rows differs from that of their neighbours in all views, 40 by +5." in doubts
    assert "images.lines: {along: rows} evens them" in doubts
    found, doubts = told_of(views, lines={"along": "rows"})
    assert not doubts
    np.testing.assert_allclose(found[:, 40], right[:, 40], rtol=0.01)


def test_a_readout_that_flickers_is_named_and_evened(noisy, told_of):
    right, _ = told_of(noisy)
    views = noisy.copy()
    views[11, 30] += 0.06
    _, doubts = told_of(views)
    assert "rows of single views (1)" in doubts
    assert "the most in image 11, row 30, by +6." in doubts
    found, doubts = told_of(views, lines={"along": "rows", "kind": "offset"})
    assert not doubts
    np.testing.assert_allclose(found[11, 30], right[11, 30], atol=0.003)


@pytest.mark.parametrize("kind", ["gain", "offset"])
def test_rows_that_all_flicker_are_evened(kind, noisy, told_of):
    right, _ = told_of(noisy)
    off = np.random.default_rng(9).normal(0, 0.02, (36, 96, 1))
    views = noisy * (1 + off) if kind == "gain" else noisy + off
    left, doubts = told_of(views)
    assert "air of rows of single views (" in doubts
    found, doubts = told_of(views, lines={"along": "rows", "kind": kind})
    assert not doubts
    assert error(found, right) < error(left, right) / 5


@pytest.mark.parametrize("step", [0.03, -0.1])
def test_tiles_are_named(step, noisy, told_of):
    views = noisy.copy()
    views[:, :, 60:] *= 1 + step
    _, doubts = told_of(views)
    assert "brightness steps at columns" in doubts and "tiles of other gains?" in doubts
    line, found = re.search(r"steps at columns (\d+) by (\S+)%", doubts).groups()
    assert abs(int(line) - 60) <= 1
    assert abs(float(found) / 100 - step) < 0.01


def test_lines_without_air_are_refused(noisy, told_of):
    from twinct.core.errors import InputError

    columns = np.arange(104) / 104
    shade = np.exp(-1 - 0.5 * np.sin(2 * np.pi * (np.arange(36)[:, None, None] / 36 + columns)))
    with pytest.raises(InputError, match="images.lines, but no part of the panel is bright"):
        told_of(noisy * shade, lines={"along": "rows"})
