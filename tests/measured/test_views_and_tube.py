"""Faults of views and tube that an import names: drift, flats of an object, order of the views."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from soft_balls import circle_of, images

FREE = 30000.0
VIEWS = 36
CLEAN = np.exp(-images(circle_of(VIEWS)))
EMPTY = np.ones(CLEAN.shape[1:])


@pytest.fixture
def told_of(imported, stored, circle):
    """A function that imports counts of some views, and returns the scan and the doubts."""

    def run(views, photons=20000.0, angles=None, **keys):
        rng = np.random.default_rng(8)
        lit = FREE * (views if photons is None else rng.poisson(views * photons) / photons)
        geometry = circle | {"sod_mm": 200.0, "sdd_mm": 400.0, "pitch_mm": 2.4}
        geometry["angles"] = angles or {"step": 360 / len(views)}
        section = stored(np.round(lit).astype(np.uint16), "intensities", **{"white": FREE} | keys)
        scan, told = imported({"images": section, "geometry": geometry})
        return scan, "\n".join(told.doubts)

    return run


@pytest.mark.parametrize("photons", [20000.0, 1000.0])
def test_a_steady_scan_is_not_doubted(photons, told_of):
    assert not told_of(CLEAN, photons)[1]


@pytest.mark.parametrize("kind", ["drifts", "flickers"])
def test_a_tube_that_is_not_steady_is_named_and_followed(kind, told_of):
    rng = np.random.default_rng(3)
    tube = np.linspace(1.0, 0.96, VIEWS) if kind == "drifts" else rng.normal(1, 0.01, VIEWS)
    _, doubts = told_of(CLEAN * tube[:, None, None])
    least, most = int(tube.argmin()), int(tube.argmax())
    assert f"air {kind} from 0.9" in doubts
    assert f"in image {least} to" in doubts and f"in image {most}, by more than its noise" in doubts
    assert "images.air: auto" in doubts
    right, _ = told_of(CLEAN)
    scan, doubts = told_of(CLEAN * tube[:, None, None], air="auto")
    assert not doubts
    ratio = np.median(scan.transmission / right.transmission, axis=(1, 2))
    np.testing.assert_allclose(ratio, 1, rtol=0.002)


def test_flats_that_hold_the_object_are_named(told_of, tmp_path):
    for name, image in (("object", CLEAN[0]), ("empty", EMPTY)):
        np.save(tmp_path / f"{name}.npy", FREE * image[None])
        _, doubts = told_of(CLEAN, white=None, flats=[{"path": str(tmp_path / f"{name}.npy")}])
        assert ("do images.flats hold the object" in doubts) == (name == "object")
    assert not doubts


def test_repeated_images_are_named(told_of):
    views = CLEAN.copy()
    _, doubts = told_of(views, photons=None)
    assert not doubts
    views[17] = views[16]
    _, doubts = told_of(views, photons=None)
    assert "images repeat earlier ones to the last bit: 17 like 16: did" in doubts


@pytest.mark.parametrize("photons", [20000.0, 1000.0])
def test_views_out_of_order_are_named(photons, told_of):
    order = np.arange(VIEWS)
    order[[12, 13]] = 13, 12
    _, doubts = told_of(CLEAN[order], photons)
    assert "images 12 and 13 fit their neighbours better if they are exchanged" in doubts
    order = np.arange(VIEWS)
    order[20] = 3
    _, doubts = told_of(CLEAN[order], photons)
    assert "but not from a view elsewhere: 20 (like 3): are they out of order" in doubts


def test_a_turn_whose_ends_meet_is_named(told_of):
    both_ends = np.concatenate([CLEAN, CLEAN[:1]])
    _, doubts = told_of(both_ends, angles={"step": 360 / VIEWS})
    assert f"images 0 and {VIEWS} have one pose: it counts twice" in doubts
    _, doubts = told_of(both_ends)
    assert f"images 0 and {VIEWS} are alike" in doubts
    assert "do the angles include both ends of the turn?" in doubts
    _, doubts = told_of(CLEAN, angles={"step": 360 / (VIEWS - 1)})
    assert f"images 0 and {VIEWS - 1} have one pose, but differ" in doubts


def test_golden_angles_are_in_order(imported, stored, circle):
    step = 137.50776
    golden = circle_of(89, angles={"step": step})
    section = stored(images(golden))
    geometry = circle | {"sod_mm": 200.0, "sdd_mm": 400.0, "pitch_mm": 2.4}
    _, told = imported({"images": section, "geometry": geometry | {"angles": {"step": step}}})
    assert not [one for one in told.doubts if "image" in one and "order" in one]


def test_missing_numbers_of_files_are_named(imported, circle, tmp_path):
    kept = [v for v in range(VIEWS) if v not in (7, 20, 21)]
    for view in kept:
        lit = np.round(FREE * CLEAN[view]).astype(np.uint16)
        tifffile.imwrite(tmp_path / f"scan_{view:04d}.tif", lit)
    section = {"path": str(tmp_path / "scan_*.tif"), "values": "intensities", "white": FREE}
    angles = {"values": [10.0 * view for view in kept]}
    _, told = imported({"images": section, "geometry": circle | {"angles": angles}})
    assert "the numbers of the files leave out 7, 20, 21: are views missing?" in str(told.doubts)
