"""Pixels that detectors spoil: repaired, counted and named, while fine structures stay."""

from __future__ import annotations

import re

import numpy as np
import pytest
import tifffile
from soft_balls import circle_of, images

from twinct.core.errors import InputError
from twinct.measured.circle import Circle
from twinct.measured.pixels import ThreeViews, levels_of, singles
from twinct.measured.views import ImageFacts
from twinct.xray.beam import fall_off

FREE = 30000.0
CLEAN = np.exp(-images(circle_of()))
COUNTS = np.round(FREE * CLEAN).astype(np.uint16)


@pytest.fixture
def circle(circle):
    turn = {"angles": {"step": 360 / len(CLEAN)}, "pitch_mm": 2.4}
    return circle | turn | {"sod_mm": 200.0, "sdd_mm": 400.0}


@pytest.fixture
def told_of(imported, stored, circle):
    """A function that imports intensities, and returns the scan, the notes and the doubts."""

    def run(counts, **keys):
        keys = {"white": FREE} | keys
        section = stored(counts, "intensities", **keys)
        scan, told = imported({"images": section, "geometry": circle})
        return scan, "\n".join(told.notes), "\n".join(told.doubts)

    return run


@pytest.mark.parametrize("share", [0.02])
@pytest.mark.parametrize("value", [65535, 0, "random"])
def test_hits_are_repaired_and_counted(share, value, told_of):
    rng = np.random.default_rng(5)
    where = rng.random(COUNTS.shape) < share
    struck = COUNTS.copy()
    height = rng.uniform(5000, 30000, where.sum()).astype(np.uint16)
    struck[where] = COUNTS[where] + height if value == "random" else value
    clean, none, _ = told_of(COUNTS)
    scan, notes, doubts = told_of(struck)
    assert (scan.transmission[~where] == clean.transmission[~where]).mean() > 0.9999
    off = np.abs(scan.transmission - clean.transmission)[where]
    assert (off < 0.02).mean() > 0.93
    kind = "dark" if value == 0 else "bright"
    count = int(re.search(rf"{kind} single pixels\s+(\d+)", notes)[1])
    assert 0.93 * where.sum() < count < 1.02 * where.sum()
    assert re.search(r"bright single pixels\s+none", none)
    assert not doubts
    left, off_notes, _ = told_of(struck, single_pixels=False)
    lit = struck > 0  # a count of 0 is starved
    assert (left.transmission[lit] == (struck[lit] / FREE).astype(np.float32)).all()
    assert "not looked for (images.single_pixels)" in off_notes


def stand_out(view, *, before=None, after=None):
    three = ThreeViews(
        np.ones_like(view) if before is None else before,
        view,
        np.ones_like(view) if after is None else after,
    )
    bright, dark = singles(three, levels_of([three], 0.0))
    return bright | dark


def test_fine_structures_stay():
    """Wires one pixel thick with their ends, a mesh and its holes, a ball and a sharp edge."""
    view = np.ones((60, 60))
    view[5, 5:30] = view[10:30, 8] = 0.4
    view[np.arange(10, 30), np.arange(20, 40)] = 0.4
    view[35:55:3, 5:25] = view[35:55, 5:25:3] = 0.6
    view[10:12, 50:52] = 0.2
    view[40:, 40:] = 0.05
    assert not stand_out(view).any()
    other = view.copy()
    view[20, 50] = view[50, 50] = 0.5
    view[34, 33:35] = 1.4
    expected = np.zeros(view.shape, bool)
    expected[20, 50] = expected[50, 50] = True
    expected[34, 33:35] = True
    np.testing.assert_array_equal(stand_out(view, before=other, after=other), expected)


def test_details_that_stay_in_a_pixel_are_no_hits():
    view = np.ones((20, 20))
    view[9, 9] = 0.5
    assert stand_out(view)[9, 9]
    assert not stand_out(view, before=view, after=view).any()


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("stated", [None, 8.0])
def test_starved_pixels_are_means_of_dark_neighbours(cut, stated, told_of):
    """Line integrals rise to 18 at 3000 photons, with a dark noise of 8."""
    rng = np.random.default_rng(2)
    deep = CLEAN ** (18 / -np.log(CLEAN.min()))
    counts = rng.poisson(3000 * deep) + rng.normal(0, 8, deep.shape)
    counts = np.clip(np.round(counts), 0, None) if cut else counts
    keys = {} if stated is None else {"dark_noise": stated}
    scan, notes, _ = told_of(counts, white=3000.0, **keys)
    sigma = float(re.search(r"dark noise\s+(\S+) of air", notes)[1])
    assert 0.8 < sigma / (8 / 3000) < (1.3 if stated is None else 1.01)
    assert scan.transmission.min() > sigma / 10
    dark = (deep > 4 / 3000) & (deep < 20 / 3000)
    clamped = np.maximum(counts / 3000, sigma)
    ours = np.log(scan.transmission[dark] / deep[dark])
    theirs = np.log(clamped[dark] / deep[dark])
    assert np.sqrt((ours**2).mean()) < 0.9 * np.sqrt((theirs**2).mean())
    bright = deep > 60 / 3000
    same = scan.transmission[bright] == (counts[bright] / 3000).astype(np.float32)
    assert same.mean() > 0.99
    assert re.search(r"starved pixels\s+\d+ \(\d", notes)


def test_whole_counts_of_zero_are_less_than_one_count(told_of):
    counts = COUNTS.copy()
    counts[:, 40:50, 40:50] = 0
    scan, notes, _ = told_of(counts)
    assert 0.2 / FREE / 9 < scan.transmission.min() < 0.3 / FREE
    assert "from rounding to whole numbers" in notes


@pytest.mark.parametrize("level", [0.67, 1.5, 3.0])
def test_air_beside_one_is_doubted_and_scaled(level, told_of):
    rng = np.random.default_rng(3)
    counts = rng.poisson(FREE * CLEAN)
    right, _, none = told_of(counts)
    _, notes, doubts = told_of(counts, white=FREE / level)
    assert not none
    assert f"brightest steady pixels read {level:.3g}; air must read 1" in doubts
    assert "images.air: auto" in doubts
    scan, _, doubts = told_of(counts, white=FREE / level, air="auto")
    assert not doubts
    np.testing.assert_allclose(scan.transmission, right.transmission, rtol=0.01)


BEAM = fall_off(circle_of()[[0]]).astype(float)
BEAM /= BEAM.max()
REGION = {"rows": [0, 96], "columns": [0, 4]}


@pytest.mark.parametrize(
    ("level", "air"),
    [(1.0, "auto"), (1.5, "auto"), (1.5, "fall_off"), (1.5, REGION | {"fall_off": True})],
)
def test_flats_without_the_fall_off_of_the_beam_are_doubted_and_repaired(
    level, air, told_of, tmp_path
):
    """At the corners, the beam has 0.78 of its brightness in the middle."""
    counts = np.random.default_rng(3).poisson(FREE * CLEAN * BEAM)
    np.save(tmp_path / "right.npy", FREE * BEAM[None])
    flats = {"white": None, "flats": [{"path": str(tmp_path / "right.npy")}]}
    right, _, none = told_of(counts, **flats)
    assert not none
    _, _, doubts = told_of(counts, white=FREE / level)
    assert f"air falls by {1 - BEAM.min():.1%} towards the darkest corner" in doubts
    assert "images.air: auto" in doubts
    scan, notes, doubts = told_of(counts, white=FREE / level, air=air)
    assert f"the beam's fall-off, from 1 to {BEAM.min():.4g}" in notes
    expected = right.transmission * (level if air == "fall_off" else 1.0)
    np.testing.assert_allclose(scan.transmission, expected, rtol=0.01)
    assert ("air must read 1" in doubts) == (air == "fall_off" and level != 1.0)


def test_air_of_right_flats_is_left_as_even_as_it_is(told_of, tmp_path):
    counts = np.random.default_rng(4).poisson(FREE * CLEAN * BEAM)
    np.save(tmp_path / "right.npy", FREE * BEAM[None])
    flats = {"white": None, "flats": [{"path": str(tmp_path / "right.npy")}]}
    right, _, _ = told_of(counts, **flats)
    scan, notes, doubts = told_of(counts, **flats, air="auto")
    assert "fall-off" not in notes + doubts
    np.testing.assert_allclose(scan.transmission, right.transmission, rtol=0.003)


def test_the_fall_off_follows_the_turns_of_the_images(imported, stored, circle):
    """A panel far to the right and up, whose images are stored on their side and mirrored."""
    geometry = circle | {"panel_offset_mm": [80.0, 50.0], "columns": "left"}
    facts = ImageFacts(24, 96, 104)
    views = Circle.model_validate(geometry).views(facts)
    beam = fall_off(views.geometry[[0]]).astype(float)
    beam /= beam.max()
    assert not np.allclose(beam, beam[::-1], rtol=0.1)
    keys = {"transpose": True, "turn_deg": 90, "flip_rows": True}
    as_turned = beam[:, ::-1]  # columns run to the left, rows up
    as_stored = np.rot90(as_turned[::-1], -1).T
    section = stored(
        np.tile(FREE * as_stored, (24, 1, 1)), "intensities", white=FREE, air="fall_off", **keys
    )
    scan, _ = imported({"images": section, "geometry": geometry})
    np.testing.assert_allclose(scan.transmission, 1, rtol=1e-4)


def test_air_that_is_nowhere_is_not_scaled_to(told_of):
    views, columns = np.arange(len(COUNTS))[:, None, None] / 24, np.arange(104) / 104
    shaded = COUNTS * np.exp(-1 - 0.5 * np.sin(2 * np.pi * (views + columns)))
    _, notes, doubts = told_of(shaded)
    assert "air reads" in notes and "unknown: no part of the panel" in notes and not doubts
    with pytest.raises(InputError, match="images.air: auto, but no part of the panel is bright"):
        told_of(shaded, air="auto")


def test_saturated_pixels_are_counted_and_named(told_of):
    counts = np.minimum(COUNTS.astype(float) * 2.4, 65535).astype(np.uint16)
    _, notes, doubts = told_of(counts, white=FREE * 2.4)
    assert re.search(r"saturated pixels\s+\d+ \(", notes)
    assert "of the pixels are saturated, at 65535, the first in image 0" in doubts


@pytest.mark.parametrize("broken", ["dark", "nan"])
def test_a_view_without_signal_is_named(broken, told_of, tmp_path):
    counts = COUNTS.astype(float) + 100
    counts[7] = 90 if broken == "dark" else np.nan
    np.save(tmp_path / "dark.npy", np.full(COUNTS.shape[1:], 100.0))
    message = "no pixel is brighter than the dark" if broken == "dark" else "are not finite"
    with pytest.raises(InputError, match=f"images.npy: image 7: .*{message}"):
        told_of(counts, darks=[{"path": str(tmp_path / "dark.npy")}])
    assert not list(tmp_path.glob("imported*"))


def test_an_image_of_another_size_is_named_with_its_place(tmp_path, imported, circle):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for view, image in enumerate(COUNTS[:, :20]):
            file.write(image[:7] if view == 5 else image, contiguous=False)
    section = {"path": str(tmp_path / "a.tif"), "values": "intensities", "white": FREE}
    with pytest.raises(InputError, match="a.tif: .* of one size and type, but image 5 has"):
        imported({"images": section, "geometry": circle})
    assert not list(tmp_path.glob("imported*"))
