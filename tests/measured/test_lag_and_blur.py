"""Ghosts of a detector that lags, and views that moved during their exposure, are named."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from soft_balls import circle_of, images

FREE, DARK, LAG = 30000.0, 500.0, 0.02
VIEWS = 36
CLEAN = np.exp(-images(circle_of(VIEWS)))
PHOTONS = 20000.0


def balls(views: int = 90, shape: tuple[int, int] = (40, 44)) -> np.ndarray:
    """Return transmissions of small sharp balls that turn in a parallel beam."""
    rng, angle = np.random.default_rng(6), 2 * np.pi * np.arange(views) / views
    row, column = np.indices(shape) - (np.array(shape)[:, None, None] - 1) / 2
    p = np.zeros((views, *shape))
    for x, y, z, radius in rng.uniform((-12, -12, -12, 2), (12, 12, 12, 4), (12, 4)):
        across = x * np.cos(angle) + y * np.sin(angle)
        square = (column - across[:, None, None]) ** 2 + (row - z) ** 2
        p += 0.1 * np.sqrt(np.maximum(radius**2 - square, 0))
    return np.exp(-p)


def counted(beam: np.ndarray, lag: float) -> np.ndarray:
    """Return counts of a detector that keeps a part of the image before, image after image."""
    rng = np.random.default_rng(5)
    seen = rng.poisson(beam * PHOTONS) / PHOTONS
    for index in range(1, len(seen)):
        seen[index] = (1 - lag) * seen[index] + lag * seen[index - 1]
    noise = rng.normal(0, 3, seen.shape)
    return np.round(DARK + FREE * seen + noise).astype(np.uint16)


@pytest.fixture
def told_of(imported, stored, circle, tmp_path):
    """A function that imports views, flats and darks that were taken one after the other."""

    def run(views, detector=0.0, first="flats", **keys):
        size = {"flats": 4, "darks": 4}
        beam = {
            "views": views,
            "flats": np.ones((4, *views.shape[1:])),
            "darks": np.zeros((4, *views.shape[1:])),
        }
        order = ["views", first, *(set(size) - {first})]
        taken = counted(np.concatenate([beam[name] for name in order]), detector)
        parts = np.split(taken, np.cumsum([size.get(name, len(views)) for name in order])[:-1])
        by_name = dict(zip(order, parts, strict=True))
        for name in size:
            np.save(tmp_path / f"{name}.npy", by_name[name])
        geometry = circle | {"sod_mm": 200.0, "sdd_mm": 400.0, "pitch_mm": 2.4}
        geometry["angles"] = {"step": 360 / len(views)}
        fields = {name: [{"path": str(tmp_path / f"{name}.npy")}] for name in size}
        section = stored(by_name["views"], "intensities", **fields, **keys)
        scan, told = imported({"images": section, "geometry": geometry})
        return scan, "\n".join(told.doubts)

    return run


@pytest.mark.parametrize("first", ["flats", "darks"])
def test_a_detector_without_lag_is_not_doubted(first, told_of):
    assert not told_of(CLEAN, first=first)[1]


@pytest.mark.parametrize(("first", "shown"), [("flats", "image 35"), ("darks", "image 35")])
def test_a_ghost_in_the_first_flat_or_dark_image_is_named_with_its_share(first, shown, told_of):
    _, doubts = told_of(CLEAN, LAG, first)
    named = next(line for line in doubts.splitlines() if line.startswith(f"images.{first}.0"))
    assert f"of {shown}: the detector lags" in named
    share = float(named.partition("images.lag: ")[2].split()[0])
    assert share == pytest.approx(LAG, rel=0.15)


def test_the_beam_s_ghost_in_a_dark_image_is_named(told_of, tmp_path):
    """Darks that follow flats of an uneven beam show this beam."""
    _, doubts = told_of(CLEAN, 0.0)
    assert not doubts
    shape = CLEAN.shape[1:]
    beam = 0.6 + 0.4 * np.cos(np.linspace(-1.2, 1.2, shape[1]))[None] * np.ones(shape)
    dark = np.full((4, *shape), DARK) + np.random.default_rng(1).normal(0, 3, (4, *shape))
    dark[0] += LAG * FREE * beam
    np.save(tmp_path / "dark.npy", dark)
    flats = np.round(DARK + FREE * np.stack([beam] * 4))
    np.save(tmp_path / "flat.npy", flats)
    from twinct.measured.description import read_description
    from twinct.measured.fields import fields_of
    from twinct.measured.lag import ghosts
    from twinct.measured.stack import open_stack

    np.save(tmp_path / "views.npy", DARK + FREE * beam * CLEAN)
    section = read_description(
        {
            "images": {
                "path": str(tmp_path / "views.npy"),
                "values": "intensities",
                "flats": [{"path": str(tmp_path / "flat.npy")}],
                "darks": [{"path": str(tmp_path / "dark.npy")}],
            },
            "geometry": {
                "kind": "circle",
                "sod_mm": 200.0,
                "sdd_mm": 400.0,
                "pitch_mm": 2.4,
                "angles": {"step": 10.0},
                "rotates": "object",
                "direction": "clockwise",
            },
        }
    ).images
    stack = open_stack(section, "images")
    dark_field = fields_of(section.darks, "images.darks", stack)
    flat_field = fields_of(section.flats, "images.flats", stack)
    (found,) = ghosts(section, stack, dark_field, flat_field)
    assert (found.where, found.of) == ("images.darks.0", "the beam")
    assert found.share == pytest.approx(LAG, rel=0.1)


def test_stated_lag_is_taken_out_of_the_views(imported, stored, circle):
    """One draw of photons, with and without lag: only rounding is left of the difference."""
    geometry = circle | {"sod_mm": 200.0, "sdd_mm": 400.0, "pitch_mm": 2.4}
    geometry["angles"] = {"step": 360 / VIEWS}

    def transmission(detector, **keys):
        section = stored(
            counted(CLEAN, detector),
            "intensities",
            white=FREE + DARK,
            black=DARK,
            single_pixels=False,
            **keys,
        )
        return imported({"images": section, "geometry": geometry})[0].transmission[1:]

    right = transmission(0.0)
    ghosted, cured = transmission(LAG), transmission(LAG, lag=LAG)
    assert np.abs(ghosted - right).max() > 0.005
    assert np.abs(cured - right).max() < 2 / FREE, "numbers are rounded, and their errors add up"


@pytest.mark.parametrize("number", [0, 1, 3])
def test_views_that_moved_during_their_exposure_are_named(number, told_of):
    views, moved = balls(), [12, 20, 28][:number]
    for view in moved:
        views[view] = scipy.ndimage.uniform_filter1d(views[view], 4, axis=1)
    if not number:
        assert not told_of(views)[1]
        return
    _, doubts = told_of(views)
    assert "did something move during their exposure" in doubts
    names = doubts.partition("before and after: ")[2].partition(" (mean squares)")[0].split(", ")
    assert [int(name.split()[0]) for name in names] == moved
