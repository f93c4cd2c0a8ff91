"""CTSimU's metadata beside rendered images: they come back, with their fields and geometry."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
import tifffile
from small_ctsimu import small_scenario

from twinct.core.errors import InputError
from twinct.ctsimu import load_ctsimu
from twinct.ctsimu.writing import quantity
from twinct.measured import description_of


@pytest.fixture
def scan(tmp_path):
    """A scenario with few pixels, its images with and without correction, and a metadata file."""
    scenario = small_scenario() | {"samples": [], "materials": []}
    scenario["detector"] |= {"columns": quantity(8, "px"), "rows": quantity(6, "px")}
    scenario["acquisition"] |= {
        "stop_angle": quantity(360.0, "deg"),
        "include_final_angle": False,
        "dark_field": {"number": 1},
        "flat_field": {"number": 2},
    }
    (tmp_path / "small.json").write_text(json.dumps(scenario))
    return tmp_path


def field(number, name, corrected=False):
    return {"number": number, "filename": name, "projections_corrected": corrected}


def written(folder, **projections):
    """Write metadata in a folder of their own."""
    told = {
        "filename": "small_%04d.tif",
        "number": 3,
        "max_intensity": 60000,
        "datatype": "uint16",
        "byteorder": "little",
        "headersize": {"file": 0, "image": 0},
        "dimensions": {"x": {"value": 8, "unit": "px"}, "y": {"value": 6, "unit": "px"}},
        "dark_field": field(0, None),
        "flat_field": field(0, None),
        "bad_pixel_map": field(0, None),
        **projections,
    }
    data = {
        "file": {"name": "small", "file_type": "CTSimU Metadata"},
        "output": {"projections": told},
        "acquisition_geometry": {"path_to_CTSimU_JSON": "../small.json"},
    }
    path = folder / "out" / "small_metadata.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(data))
    return path


def test_images_fields_and_geometry_come_back(scan, imported):
    rng = np.random.default_rng(5)
    truth = rng.uniform(0.2, 1, (3, 6, 8))
    dark, gain = rng.uniform(90, 110, (6, 8)), rng.uniform(20000, 50000, (6, 8))
    fields = {
        "dark_field": field(1, "small_dark.tif"),
        "flat_field": field(2, "small_flat_%04d.tif"),
    }
    path = written(scan, **fields)
    for index, image in enumerate(truth):
        tifffile.imwrite(path.parent / f"small_{index:04d}.tif", (dark + gain * image).astype("f4"))
    for index in range(2):
        tifffile.imwrite(path.parent / f"small_flat_{index:04d}.tif", (dark + gain).astype("f4"))
    tifffile.imwrite(path.parent / "small_dark.tif", dark.astype("f4"))
    found, _ = imported(path)
    np.testing.assert_allclose(found.transmission, truth[:, ::-1], rtol=1e-5)
    points = np.array([[0, 0, 0], [5, -3, 4.0]])
    believed = load_ctsimu(scan / "small.json").geometry(believed=True)
    np.testing.assert_allclose(
        found.geometry().project(points), believed.project(points), atol=1e-6
    )


def changed(folder, **sections):
    """Change sections of the scenario."""
    scenario = json.loads((folder / "small.json").read_text())
    for name, keys in sections.items():
        scenario[name] = scenario[name] | keys
    (folder / "small.json").write_text(json.dumps(scenario))


def test_without_flat_images_the_beam_falls_off_and_darkness_is_that_of_the_scenario(
    scan, imported
):
    """The panel of 6 x 8 pixels of 40 mm: the corners get 0.80 of the brightest pixel."""
    pitch = {"u": quantity(40.0, "mm"), "v": quantity(40.0, "mm")}
    changed(scan, detector={"pixel_pitch": pitch, "gray_value": {"imin": quantity(500)}})
    down, right = (40.0 * (np.arange(n) - (n - 1) / 2) for n in (6, 8))
    beam = (1 + (down[:, None] ** 2 + right**2) / 400**2) ** -1.5
    beam /= beam.max()
    assert beam.min() < 0.8
    truth = np.random.default_rng(7).uniform(0.2, 1, (3, 6, 8))
    path = written(scan, dark_field=field(0, "none.tif"), flat_field=field(0, "none.tif"))
    for index, image in enumerate(truth):
        grey = 500 + 59500 * beam * image
        tifffile.imwrite(path.parent / f"small_{index:04d}.tif", grey.astype("f4"))
    found, told = imported(path)
    np.testing.assert_allclose(found.transmission, truth[:, ::-1], rtol=1e-5)
    assert f"the beam's fall-off, from 1 to {beam.min():.4g}" in "\n".join(told.notes)


def test_only_the_geometry_of_the_scenario_is_needed(scan, imported):
    """Files of detector, tube and samples may be missing, and scattering may be on."""
    gone = {"file": quantity("gone.raw")}
    changed(
        scan,
        detector={"type": "real", "bad_pixel_map": gone, "noise": {"snr_at_imax": quantity(-1)}},
        source={"spectrum": gone, "target": {"material_id": "Mo"}},
        acquisition={"scattering": True, "pixel_binning": {"u": quantity(2), "v": quantity(2)}},
    )
    fields = {name: field(1, None, True) for name in ("dark_field", "flat_field")}
    sizes = {"x": {"value": 4, "unit": "px"}, "y": {"value": 3, "unit": "px"}}
    path = written(scan, dimensions=sizes, **fields)
    for index in range(3):
        lit = np.full((3, 4), 30000, np.uint16)
        tifffile.imwrite(path.parent / f"small_{index:04d}.tif", lit)
    found, _ = imported(path)
    np.testing.assert_allclose(found.transmission, 0.5, rtol=1e-6)
    assert found.geometry().panel.size_mm == (16.0, 12.0)


SUITE = Path(
    os.environ.get("CTSIMU_DATA", Path(__file__).resolve().parents[3] / "shared/data/ctsimu")
)


@pytest.mark.parametrize("name", ["01_full", "02_simple_scan_circular", "03_simple_scan_helix"])
def test_corners_of_air_are_bright_in_scans_of_the_suite(name, imported):
    if not SUITE.is_dir():
        pytest.skip(f"BAM's scans are not at {SUITE}")
    found, told = imported(next((SUITE / name).glob("projections/*_metadata.json")))
    for rows in (slice(5), slice(-5, None)):
        for columns in (slice(5), slice(-5, None)):
            air = np.median(found.transmission[:, rows, columns])
            assert abs(air - 1) < 0.01
    once = [doubt for doubt in told.doubts if "have one pose" not in doubt]  # the turn of 02 closes
    assert not once


def test_corrected_raw_images_are_divided_by_the_largest_intensity(scan, imported):
    truth = np.random.default_rng(6).uniform(0.2, 1, (3, 6, 8))
    fields = {name: field(1, None, True) for name in ("dark_field", "flat_field")}
    header = {"headersize": {"file": 16, "image": 0}, "byteorder": "big", "datatype": "float32"}
    path = written(scan, filename="small_%04d.raw", **fields, **header)
    for index, image in enumerate(truth):
        data = bytes(16) + (60000 * image).astype(">f4").tobytes()
        (path.parent / f"small_{index:04d}.raw").write_bytes(data)
    found, _ = imported(path)
    np.testing.assert_allclose(found.transmission, truth[:, ::-1], rtol=1e-6)


@pytest.mark.parametrize(
    ("projections", "message"),
    [
        ({"filename": None}, "without 'output.projections.filename'"),
        ({"max_intensity": None}, "max_intensity: None: it must be the intensity without object"),
        (
            {"dark_field": field(1, None, True), "flat_field": field(1, "small_flat.tif")},
            "corrected by the dark images, but not by the flat ones",
        ),
        ({"filename": "a.raw", "datatype": "bfloat"}, "datatype: bfloat; known are uint8"),
        ({"filename": "a.raw", "headersize": {"image": 4}}, "headersize.image: 4: a header"),
    ],
)
def test_metadata_that_cannot_be_used_are_named(projections, message, scan):
    with pytest.raises(InputError, match=message):
        description_of(written(scan, **projections))
