from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.observers import IterationDone
from twinct.recon.volume import Volume
from twinct.runs import Run
from twinct.viewer.curves import curves
from twinct.viewer.following import mark
from twinct.viewer.numbers import nearest_view, of_pixel, of_point, of_view, on_surface
from twinct.viewer.run_folder import RunFolder


@pytest.fixture
def copy(finished: Run, tmp_path: Path) -> Path:
    """The finished run, to be changed."""
    out = tmp_path / "copy"
    shutil.copytree(finished.paths.path, out)
    return out


def take_back(out: Path, first: int) -> list[tuple[Path, bytes]]:
    """As if the views from ``first`` on were not stored yet; what brings them back."""
    kept = []
    for view in range(first, 8):
        status = out / "scan.zarr" / "status" / f"c.{view}"
        kept.append((status, status.read_bytes()))
        status.unlink()
    for name in ("volume.nii", "metrics.json", "report.html", "truth.nii"):
        (out / name).unlink()
    shutil.rmtree(out / "geometries")
    return kept


def test_a_finished_run_is_shown_whole(finished: Run) -> None:
    show = RunFolder(finished.paths.path).look()
    scan = finished.scan
    assert show.acquired == len(show) == 8
    assert list(show.geometries) == ["commanded", "executed", "believed"]
    for name, geometry in show.geometries.items():
        assert geometry == scan.poses(name).geometry(scan.scenario.detector.panel), name
    assert np.array_equal(show.joints, scan.joints)
    assert show.transmission is not None
    assert np.array_equal(show.transmission(5), scan.transmission[5])
    assert list(show.volumes) == ["reconstruction", "truth"]
    assert np.array_equal(show.volumes["reconstruction"].array, finished.volume.array)
    assert show.residuals == {"believed": tuple(finished.figures["residuals"]["believed"])}
    assert not show.problems


def test_volumes_are_mapped_and_not_read(finished: Run) -> None:
    array = RunFolder(finished.paths.path).look().volumes["reconstruction"].array
    while isinstance(array, np.ndarray) and not isinstance(array, np.memmap):
        array = array.base
    assert isinstance(array, np.memmap)


def test_views_come_as_they_are_stored(copy: Path, finished: Run) -> None:
    kept = take_back(copy, 3)
    folder = RunFolder(copy)
    before = folder.look()
    assert before.acquired == 3 and len(before) == 8
    assert len(before.geometries["commanded"]) == 8
    assert len(before.geometries["executed"]) == len(before.geometries["believed"]) == 3
    # Where it is not taken yet, the plan knows where the arms will be.
    assert before.joints_at(6) is not None
    assert mark(folder.look()) == mark(before)  # nothing happened
    for status, data in kept:
        status.write_bytes(data)
    after = folder.look()
    assert mark(after) != mark(before)
    assert after.acquired == 8
    assert after.geometries["believed"] == finished.scan.believed.geometry(
        finished.scenario.detector.panel
    )
    assert np.array_equal(after.clearance_mm, finished.scan.clearance_mm)


def test_a_volume_that_is_not_there_yet_is_said(copy: Path) -> None:
    take_back(copy, 8)
    show = RunFolder(copy).look()
    assert [p for p in show.problems if "volume.nii does not exist yet" in p]


def test_an_iteration_under_way_is_shown(copy: Path, finished: Run) -> None:
    take_back(copy, 8)
    (copy / "checkpoints").mkdir()
    array = np.full(finished.volume.array.shape, 0.5, np.float32)
    file = copy / "checkpoints" / "believed-0123456789abcdef-0002.npz"
    np.savez(file, volume=array, residuals="[0.5, 0.25]")
    folder = RunFolder(copy)
    show = folder.look()
    assert show.state == "8 of 8 views; reconstruction, iteration 2"
    assert np.array_equal(show.volumes["reconstruction"].array, array)
    assert show.residuals == {"believed": (0.5, 0.25)}
    file.unlink()
    np.savez(file.with_name("believed-0123456789abcdef-0003.npz"), volume=2 * array, residuals="[]")
    assert folder.look().volumes["reconstruction"].array.max() == 1.0


def test_an_iteration_of_this_process_is_not_read_from_disk(copy: Path, finished: Run) -> None:
    take_back(copy, 8)
    folder = RunFolder(copy, live=True)
    for number, residual in ((1, 0.5), (2, 0.25)):
        volume = Volume(np.full_like(finished.volume.array, number), finished.volume.grid)
        folder.iterated(IterationDone("sart", "believed", number, 2, residual, volume))
    show = folder.look()
    assert show.volumes["reconstruction"] is volume
    assert show.residuals == {"believed": (0.5, 0.25)}
    assert show.state == "8 of 8 views; reconstruction, iteration 2"


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a run folder: it holds neither"):
        RunFolder(tmp_path)
    with pytest.raises(InputError, match="there is no such folder"):
        RunFolder(tmp_path / "nothing")


def test_a_folder_that_vanishes_is_one_message(copy: Path) -> None:
    folder = RunFolder(copy)
    folder.look()
    shutil.rmtree(copy)
    with pytest.raises(InputError, match="is gone: the page shows its last state"):
        folder.look()


def test_curves_are_the_figures_of_the_run(finished: Run) -> None:
    errors, gaps, residuals = curves([RunFolder(finished.paths.path).look()])
    means = finished.figures["pose_error"]
    assert errors.series["commanded, source"].mean() == pytest.approx(
        means["source"]["position_mm"]["mean"]
    )
    assert errors.series["commanded, panel"].mean() == pytest.approx(
        means["detector"]["position_mm"]["mean"]
    )
    assert gaps.series["gap"].min() == finished.figures["clearance_mm"]["min"]
    assert len(residuals.x) == 2 and not residuals.over_views
    mark = errors.marked(3)
    assert np.isfinite(mark).tolist() == [view == 3 for view in range(8)]


def test_a_click_tells_numbers(finished: Run) -> None:
    show = RunFolder(finished.paths.path).look()
    executed = show.geometries["executed"]
    view, row, column = 2, 7, 40
    eye = executed.source[view] + 30.0
    pixel = executed.pixel_centres(view)[row, column]
    told = of_pixel(show, executed[view], view, eye, pixel - eye, 0.0)
    assert told is not None and f"column {column}, row {row}" in told
    assert f"transmission {finished.scan.transmission[view, row, column]:.5f}" in told
    assert nearest_view(show, "executed", eye, executed.source[5] - eye) == 5
    numbers = of_view(show, view)
    off = np.linalg.norm(show.geometries["believed"].source[view] - executed.source[view])
    assert f"distance from executed: {off:.3f} mm source" in numbers
    truth = show.volumes["truth"]
    level = 0.5 * float(truth.array.max())
    eye = np.array([-200.0, 150.0, 130.0])
    point = on_surface(show, "truth", level, eye, -eye)
    assert point is not None
    # Between the sphere and half a voxel's diagonal.
    assert np.linalg.norm(point) == pytest.approx(35.0, abs=6.0)
    assert "truth: " in (of_point(show, point, "surface") or "")
