"""A scan rendered again: what is left of its images, and which cause could explain it."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
import tifffile
import trimesh
from ball_scan import BALL, MU, RADIUS, SDD, SOD, VIEWS, ball_images, orbit
from scipy.optimize import brentq

from twinct.cli import run_command
from twinct.core.errors import InputError, ScanExistsError
from twinct.measured import prediction
from twinct.measured.prediction import predict
from twinct.observers import IterationDone, Observer
from twinct.recon.residuals import residuals_of
from twinct.runs import reconstruct_run
from twinct.runs.folder import Folder
from twinct.scenario import load_scenario
from twinct.specimen.materials import material
from twinct.xray import Imager

GRID = {"voxels": [40, 40, 24], "voxel_mm": 1.0}
ENGINE = "xray.engine=mesh"
MAGNIFIED = SDD / SOD
ENERGY = brentq(lambda kev: material("water").mu_per_mm(kev) - MU, 20, 60)
"""Photon energy at which water attenuates as the ball does."""


def blobs(shift=(0.0, 0.0)) -> np.ndarray:
    """Two smooth shadows in three views, shifted by (columns, rows) pixels."""
    y, x = np.mgrid[:40, :50].astype(float)
    x, y = x - shift[0], y - shift[1]
    image = np.exp(-((x - 20) ** 2 + (y - 22) ** 2) / 60)
    image += 0.7 * np.exp(-((x - 33) ** 2 + (y - 15) ** 2) / 30)
    return np.stack([image, 0.8 * image, 1.1 * image]).astype(np.float32)


def left(measured: np.ndarray, predicted: np.ndarray) -> tuple[float, ...]:
    found = residuals_of(np.arange(3), measured, predicted, np.ones(measured.shape, bool))
    return (found.rms_rel, *found.left_rel)


def test_a_shifted_shadow_is_told_in_pixels_and_counts_as_calibration() -> None:
    measured, counts = blobs((0.3, -0.2)), np.ones((3, 40, 50), bool)
    found = residuals_of(np.array([1, 3, 5]), measured, blobs(), counts)
    for one in found.views:
        assert one.shift_px == pytest.approx((0.3, -0.2), abs=0.02)
    assert [one.view for one in found.views] == [1, 3, 5]
    assert found.rms_rel > 0.03 and found.left_rel[0] < 0.1 * found.rms_rel


def test_a_bent_curve_counts_as_spectrum_and_a_smooth_cast_as_scatter() -> None:
    q = blobs()
    whole, moved, bent, _ = left(q - 0.05 * q**2, q)
    assert moved > 0.5 * whole and bent < 0.25 * whole
    cast = 0.05 * (1 + np.linspace(-1, 1, 50, dtype=np.float32) ** 2)
    whole, moved, bent, rest = left(q + cast, q)
    assert bent > 0.3 * whole and rest < 0.5 * bent
    noise = np.random.default_rng(1).normal(0, 0.02, q.shape).astype(np.float32)
    whole, *_, rest = left(q + noise, q)
    assert rest > 0.99 * whole


def test_rays_that_do_not_count_change_nothing() -> None:
    q, counts = blobs(), np.ones((3, 40, 50), bool)
    counts[:, 5:9, 5:9] = False
    spoiled = q.copy()
    spoiled[~counts] = 100
    assert residuals_of(np.arange(3), spoiled, q, counts).rms_rel == 0


@pytest.fixture
def scan(imported, stored, circle):
    """A function that imports images of the ball, and returns the folder."""

    def of(images, **scenario):
        source = {"name": "ball", "images": stored(images), "geometry": circle, "grid": GRID}
        return imported(source | {"scenario": scenario})[1].folder

    return of


@pytest.fixture
def ball(tmp_path):
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    mesh.export(tmp_path / "sphere.stl")
    return tmp_path / "sphere.stl"


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Leave out the picture, which takes most of the time."""
    monkeypatch.setattr(prediction, "show_prediction", lambda *_: None)


def at(place) -> str:
    return f"specimen.position_mm={list(map(float, place))}"


@pytest.mark.usefixtures("undrawn")
def test_a_mesh_predicts_all_views_and_its_wrong_place_is_seen(scan, ball) -> None:
    folder = scan(ball_images(orbit()), source={"energy_kev": ENERGY})
    right = predict(folder, [at(BALL), ENGINE], mesh=ball)
    assert len(right.residuals.views) == VIEWS and right.name == "sphere"
    assert right.residuals.rms_rel < 0.02
    wrong = predict(folder, [at(BALL - [0, 0, 0.4]), ENGINE], mesh=ball)
    assert wrong.name == "sphere-2" and wrong.residuals.rms_rel > 3 * right.residuals.rms_rel
    # Rows run upwards with 2 mm: the measured shadow is above the predicted one.
    shifts = np.array([one.shift_px for one in wrong.residuals.views])
    assert np.median(shifts[:, 1]) == pytest.approx(0.4 * MAGNIFIED / 2, rel=0.2)
    assert np.abs(np.median(shifts[:, 0])) < 0.02


def test_even_views_predict_odd_ones_and_a_wrong_view_stands_out(scan) -> None:
    images = ball_images(orbit())
    images[7] = np.roll(images[7], 1, axis=1)
    folder = scan(images)
    keys = ["reconstruction.algorithm=sart", "reconstruction.iterations=6"]
    reconstruct_run(folder, ["reconstruction.algorithm=fdk"])
    assert "Predictions beside" not in (folder / "report.html").read_text(encoding="utf-8")
    made = predict(folder, [*keys, "reconstruction.grid.rotation_deg=[10,20,30]"])
    views = made.residuals.views
    assert [one.view for one in views] == list(range(1, VIEWS, 2))
    worst = max(views, key=lambda one: one.rms_rel)
    # It is 1.32 px here: twelve views alone make the volume.
    assert worst.view == 7 and worst.shift_px[0] == pytest.approx(1, abs=0.4)
    told = json.loads((made.path / "prediction.json").read_text())
    assert told["residual_rel"] == made.residuals.rms_rel and told["views"][3]["view"] == 7
    with (made.path / "views.csv").open() as file:
        assert [int(row["view"]) for row in csv.DictReader(file)] == list(range(1, VIEWS, 2))
    off = tifffile.imread(made.path / "residuals.tif")
    assert np.sqrt(np.mean(off[3] ** 2)) == pytest.approx(views[3].rms, rel=0.3)
    assert (made.path / "prediction.png").stat().st_size > 10_000
    assert sorted(p.name for p in made.path.parent.iterdir()) == ["volume"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Predictions beside" in page and f"{100 * made.residuals.rms_rel:.2f} %" in page


def two_lines(tmp_path):
    path = tmp_path / "spectrum.txt"
    path.write_text("25 1\n60 1\n")
    return {"spectrum": {"kind": "file", "path": str(path)}}


@pytest.mark.tutorial
@pytest.mark.usefixtures("undrawn")
def test_the_right_spectrum_leaves_less_than_one_energy(scan, ball, tmp_path) -> None:
    """Images of the ball with two energies, made by the X-ray simulation itself."""
    source = two_lines(tmp_path)
    folder = scan(ball_images(orbit()), source=source)
    hard = predict(folder, [at(BALL), ENGINE], mesh=ball, name="hard")
    bent = ball_images(orbit()) - tifffile.imread(hard.path / "residuals.tif")
    folder = scan(bent, source=source)
    right = predict(folder, [at(BALL), ENGINE], mesh=ball).residuals
    one = ["source.spectrum=null", f"source.energy_kev={42.5}"]
    wrong = predict(folder, [at(BALL), ENGINE, *one], mesh=ball).residuals
    assert right.rms_rel < 1e-3 and wrong.rms_rel > 0.02
    assert wrong.left_rel[1] < 0.5 * wrong.left_rel[0]
    # The scan's own volume is corrected for the spectrum, and predicts through it.
    keys = ["reconstruction.algorithm=sart", "reconstruction.iterations=10"]
    own = predict(folder, keys)
    assert "as water" in own.in_words and "file spectrum" in own.in_words
    assert own.residuals.rms_rel < 0.4


@pytest.mark.usefixtures("undrawn")
def test_interruptions_leave_no_half_prediction(scan, ball, monkeypatch) -> None:
    def stop(*_args) -> None:
        raise KeyboardInterrupt

    folder = scan(ball_images(orbit()), source={"energy_kev": ENERGY})
    with monkeypatch.context() as patch:
        patch.setattr(Imager, "render", stop)
        with pytest.raises(KeyboardInterrupt):
            predict(folder, [at(BALL), ENGINE], mesh=ball)
    assert not (folder / "predictions").exists()
    predict(folder, [at(BALL), ENGINE], mesh=ball, name="mine")
    with pytest.raises(ScanExistsError, match="is another prediction; choose another --as"):
        predict(folder, [at(BALL), ENGINE], mesh=ball, name="mine")


@pytest.mark.usefixtures("undrawn")
def test_the_command_says_what_is_left(scan, ball, capfd, tmp_path) -> None:
    folder = scan(ball_images(orbit()), source={"energy_kev": ENERGY})
    keys = ["--set", at(BALL), "--set", ENGINE, "--mesh", str(ball)]
    assert run_command(["predict", str(folder), *keys, "--as", "mine"]) == 0
    said = " ".join(capfd.readouterr().out.split())
    assert "meshes, as water;" in said
    assert "24 views predicted: residual" in said and "after calibration" in said
    for wrong, words in (
        (["--set", "trajectory.views=3"], "a prediction changes only keys of source, detector"),
        (["--geometry", "none"], "unknown geometry"),
        (["--mesh", str(tmp_path / "gone.stl")], "gone.stl"),
        (["--material", "unobtainium", "--set", "source.energy_kev=60"], "unobtainium"),
        (["--material", "unobtainium", *keys], "--material: unknown material 'unobtainium'"),
        ([*keys, "--set", at(BALL + [0, 0, 500])], "no view sees the mesh sphere, which lies at"),
    ):
        assert run_command(["predict", str(folder), *wrong]) == 2, wrong
        assert words in " ".join(capfd.readouterr().err.split())
    tiny = [*keys[:4], "--mesh", str(tmp_path / "metres.stl")]
    trimesh.creation.icosphere(1, 0.001 * RADIUS).export(tiny[-1])
    assert run_command(["predict", str(folder), *tiny]) == 0
    assert "(metres) would make it" in " ".join(capfd.readouterr().err.split())
    assert run_command(["predict", str(tmp_path)]) == 2
    assert "is not a run folder" in capfd.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_prediction_keeps_its_reconstruction(scan, monkeypatch) -> None:
    def stop(*_args) -> None:
        raise KeyboardInterrupt

    folder = scan(ball_images(orbit()))
    keys = ["reconstruction.algorithm=sart", "reconstruction.iterations=3"]
    with monkeypatch.context() as patch:
        patch.setattr(Imager, "render", stop)
        with pytest.raises(KeyboardInterrupt) as stopped:
            predict(folder, keys)
    assert "goes on from the last checkpoint" in stopped.value.__notes__[-1]
    # The run's own checkpoints hold nothing of it, such as for the live page.
    assert not (folder / "checkpoints").exists()
    assert [p.name for p in (folder / "predictions").iterdir()] == [prediction.CHECKPOINTS]
    iterations = []
    heard = Observer(iterations.append, (IterationDone,), lossless=True)
    assert predict(folder, keys, observers=[heard]).residuals.rms_rel < 0.5
    assert not iterations
    assert [p.name for p in (folder / "predictions").iterdir()] == ["volume"]


def test_the_scan_of_a_breathing_patient_is_predicted_by_its_own_volume(tmp_path) -> None:
    folder = Folder(tmp_path)
    folder.write_scenario(load_scenario("patient_breathing"))
    made, body = prediction._settings(folder, (), None, None)
    assert body is None and made.detector.noise is None
    with pytest.raises(InputError, match=r"^--mesh .*nope\.stl does not exist"):
        prediction._settings(folder, (), tmp_path / "nope.stl", None)
