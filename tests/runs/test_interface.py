"""The first lines of a notebook: a scan, its geometry and images, a volume and its figures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import twinct
from twinct.core.errors import InputError
from twinct.recon import Projector
from twinct.recon.volume import Volume
from twinct.runs import Figures, Run, truth_of
from twinct.scan import SimulationBuilder


def test_a_scan_gives_its_geometry_and_line_integrals(finished: Run) -> None:
    scan = finished.scan
    panel = scan.scenario.detector.panel
    for which in ("commanded", "executed", "believed"):
        np.testing.assert_array_equal(
            scan.geometry(which).source, scan.poses(which).geometry(panel).source
        )
    assert not np.array_equal(scan.geometry().source, scan.geometry("executed").source)
    np.testing.assert_array_equal(scan.geometry().source, scan.geometry("believed").source)
    with pytest.raises(InputError, match="'measured'; choose from commanded, executed, believed"):
        scan.geometry("measured")
    np.testing.assert_allclose(np.exp(-scan.line_integrals()), scan.transmission, rtol=1e-5)


def test_a_scan_is_shown_in_a_file(finished: Run, tmp_path: Path) -> None:
    finished.scan.show(str(tmp_path / "some.png"))
    finished.scan.show(tmp_path / "two.png", views=[0, 9])
    sizes = [(tmp_path / name).stat().st_size for name in ("some.png", "two.png")]
    assert sizes[0] > sizes[1] > 5000
    for views in ([10], [-1], [], list(range(10)) * 2):
        with pytest.raises(InputError, match=r"1 to 12 of the views 0 to 9"):
            finished.scan.show(tmp_path / "none.png", views=views)


def test_a_run_and_its_scan_show_themselves_in_a_notebook(finished: Run) -> None:
    page = finished._repr_html_()
    assert page.count("data:image/png;base64,") == 1
    figure = finished.figures["image"]["rmse_rel"]
    assert f"<td>{100 * figure:.1f}" in page and "RMSE" in page
    assert finished.settings.name in page and str(finished.paths.report) in page
    assert finished.scan._repr_png_()[:4] == b"\x89PNG"


def test_a_volume_is_evaluated_as_the_run_evaluated_it(finished: Run) -> None:
    figures = twinct.evaluate(finished.scan, finished.volume)
    told = finished.figures["image"]
    assert figures.rmse_rel == pytest.approx(told["rmse_rel"], rel=1e-6)
    assert figures.ssim == pytest.approx(told["ssim"], rel=1e-6)
    assert figures.further["edge_width_mm"] == pytest.approx(told["edge_width_mm"], rel=1e-6)


def test_figures_are_attributes_and_plain_data(finished: Run) -> None:
    figures = finished.figures
    plain = json.loads(finished.paths.metrics.read_text())
    assert figures == plain and json.dumps(figures) == json.dumps(plain)
    assert figures.image.rmse_rel == figures["image"]["rmse_rel"] > 0
    assert figures.image.further["edge_width_mm"] == figures["image"]["edge_width_mm"]
    assert figures.pose_error["source"] == plain["pose_error"]["source"]
    assert figures.seconds["total"] == plain["seconds"]["total"]
    assert figures.image_by_geometry == {}
    both = Figures({"image_by_geometry": {"executed": {**plain["image"], "psnr_db": None}}})
    (of,) = both.image_by_geometry.values()
    assert math.isnan(of.psnr_db) and of.rmse_rel == figures.image.rmse_rel


def test_a_volume_is_evaluated_on_its_own_grid(finished: Run) -> None:
    scan = finished.scan
    fine = twinct.reconstruct(scan, grid={"voxels": 27, "voxel_mm": 6}, iterations=1)
    figures = twinct.evaluate(scan, fine)
    assert 0 < figures.rmse_rel < figures.zero["rmse_rel"]
    truth = truth_of(scan, SimulationBuilder(scan.scenario))
    with pytest.raises(InputError, match="different grids"):
        twinct.evaluate(scan, fine, truth)


def test_a_function_is_an_algorithm(finished: Run) -> None:
    scan, seen = finished.scan, []

    def landweber(A, y):
        seen.append((A.geometry, y))
        return A.T(y) / 1e4

    volume = twinct.reconstruct(scan, algorithm=landweber, geometry="executed")
    ((geometry, y),) = seen
    np.testing.assert_array_equal(geometry.source, scan.geometry("executed").source)
    np.testing.assert_array_equal(y, scan.line_integrals())
    assert volume.grid == scan.scenario.reconstruction.volume_grid
    A = Projector(geometry, volume.grid)
    np.testing.assert_array_equal(volume, Volume(A.T(y) / 1e4, volume.grid))
    for wrong in (lambda A, y: y, lambda A, y: None):
        with pytest.raises(InputError, match="algorithm: the function returned"):
            twinct.reconstruct(scan, algorithm=wrong)
    with pytest.raises(InputError, match="function takes no mask"):
        mask = np.ones(scan.transmission.shape[1:], bool)
        twinct.reconstruct(scan, algorithm=landweber, mask=mask)


def test_a_geometry_is_given_itself(finished: Run) -> None:
    scan = finished.scan
    np.testing.assert_array_equal(
        twinct.reconstruct(scan, geometry=scan.geometry("executed")),
        twinct.reconstruct(scan, geometry="executed"),
    )
    with pytest.raises(InputError, match=r"geometry: 5 views of .* the scan has 10 of"):
        twinct.reconstruct(scan, geometry=scan.geometry()[:5])
