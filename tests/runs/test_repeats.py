"""Repetitions of a scan: their noise, inserted signals, and the detectability of a run."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinct import run
from twinct.core.errors import InputError
from twinct.geometry.wire import PosePairs
from twinct.report.figure_words import with_companions
from twinct.runs import reconstruct, rewrite_report, simulate
from twinct.runs.checks import check_places
from twinct.runs.predicted_and_measured import planned_detectability
from twinct.runs.repeats import Repeats
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario
from twinct.specimen.signals import Inserts, SphereSignal
from twinct.trajectory import commanded_views

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
SIGNAL = "{kind: sphere, radius_mm: 12, contrast_rel: 0.1}"
KEYS = [
    "cell={kind: gantry}",
    "xray.engine=mesh",
    "source={energy_kev: 60, photons_per_mm2_mas: 3000}",
    "trajectory={kind: circle, views: 24}",
    "detector={columns: 32, rows: 24, pixel_pitch_mm: 10, noise: {kind: quantum}}",
    "specimen.parts=[{name: water, material: water,"
    " shape: {kind: sphere, radius_mm: 70, mesh_resolution_mm: 4}}]",
    "specimen.position_mm=[0, 0, 0]",
    "reconstruction={algorithm: fdk, geometry: executed, grid: {voxels: 28, voxel_mm: 7}}",
    "evaluation={regions: [{name: inner, shape: {kind: sphere, radius_mm: 50}}],"
    f" tasks: [{{name: spot, signal: {SIGNAL}, region: inner}}]}}",
]


SCATTER = "{kind: monte_carlo, photons: 20000, views: 1, voxel_mm: 7, pixel_mm: 100}"


def scenario(*more: str) -> Scenario:
    return load_scenario(DEMO, [*KEYS, *more])


def views(of: Scenario) -> PosePairs:
    builder = SimulationBuilder(of)
    seen = PosePairs.from_geometry(commanded_views(of.trajectory, of.detector.panel))
    return replace(seen, object=(builder.specimen.world_from_specimen,) * len(seen.source))


@pytest.mark.parametrize(
    "more",
    [f"detector.scatter={SCATTER}", "detector.lag=0.1", "detector.pixel_samples=2"],
)
def test_a_repetition_is_the_view_with_other_noise(more: str) -> None:
    of = scenario(more)
    at = views(of)
    with SimulationBuilder(of).imager() as imager:
        path, before = at[3:4], at[2:3] if of.detector.lag else None
        first, *others = imager.repeated(path, 3, before, repetitions=range(13))
        assert np.array_equal(first, imager.expose(path, 3, before))
        exact = np.mean(others, axis=0)
    noise, own = np.std(others, axis=0, ddof=1), np.abs(first - exact)
    assert 0.7 < np.sqrt((own**2).mean() / (noise**2).mean()) / math.sqrt(13 / 12) < 1.3
    assert len({image.tobytes() for image in others}) == 12


def test_an_inserted_signal_takes_the_light_that_its_ball_would() -> None:
    """By the formula of a ball, in the ray nearest to its middle."""
    of = scenario("detector.noise=null", "source.photons_per_mm2_mas=null")
    at, specimen = views(of), SimulationBuilder(of).specimen
    signal = SphereSignal(kind="sphere", radius_mm=12, contrast_rel=0.1)
    mu = specimen.reference_mu(60.0)
    with SimulationBuilder(of).imager() as imager:
        shares = imager.inserted(at[5:6], 5, Inserts(signal, np.zeros((1, 3)), mu))
        plain = imager.expose(at[5:6], 5)
    assert shares.min() == pytest.approx(math.exp(-0.1 * mu * 24), rel=5e-3)
    assert plain.shape == shares.shape and (shares <= 1).all() and (shares < 1).sum() > 4


@pytest.mark.parametrize("scatter", ["null", SCATTER])
def test_scatter_veils_an_inserted_signal(scatter: str) -> None:
    of = scenario(f"detector.scatter={scatter}")
    specimen = SimulationBuilder(of).specimen
    signal = SphereSignal(kind="sphere", radius_mm=12, contrast_rel=0.1)
    mu = specimen.reference_mu(60.0)
    with SimulationBuilder(of).imager() as imager:
        shares = imager.inserted(views(of)[5:6], 5, Inserts(signal, np.zeros((1, 3)), mu))
    primary = math.exp(-0.1 * mu * 24)
    if scatter == "null":
        assert shares.min() == pytest.approx(primary, rel=0.01)
    else:
        assert primary + 0.005 < shares.min() < 0.995


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twinct.runs.reporting._room", lambda _: None)
        return run(scenario(), tmp_path_factory.mktemp("task") / "out", link="local")


def test_a_run_has_the_detectability_of_its_ensemble(finished: Any) -> None:
    told = finished.figures["image"]["tasks"]["spot"]
    assert told["detectability_low"] < told["detectability"] < told["detectability_high"]
    scan = finished.scan
    builder = SimulationBuilder(finished.scenario)
    repeats = Repeats(scan, builder)
    volume = reconstruct(scan).array
    again = repeats.of("executed", volume)
    signal = finished.scenario.evaluation.entries("tasks")[0].signal
    found = again(signal, np.zeros((1, 3)), 24)
    template = found.with_signal.astype(float) - volume
    responses = [(template * one).sum() for one in found.without]
    ensemble = (template**2).sum() / np.std(responses, ddof=1)
    # Twenty-four draws know a deviation to 15 %, and the template is the whole volume here.
    assert told["detectability_quantum"] == pytest.approx(ensemble, rel=0.4)


def test_a_report_does_not_repeat_what_is_known(finished: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("twinct.runs.reporting._room", lambda _: None)
    monkeypatch.setattr("twinct.runs.job.Repeats", lambda *_: 1 / 0)
    before = json.loads(finished.paths.metrics.read_text())["image"]["tasks"]
    again = rewrite_report(finished.paths.path)
    assert json.loads(again.paths.metrics.read_text())["image"]["tasks"] == before
    words = again.paths.report.read_text(encoding="utf-8")
    assert "d′, quantum noise alone" in words
    # Figures of before had other names: they are measured again.
    metrics = json.loads(finished.paths.metrics.read_text())
    metrics["image"]["tasks"] = {"spot": {"detectability": 82.9}}
    finished.paths.metrics.write_text(json.dumps(metrics))
    with pytest.raises(ZeroDivisionError):
        rewrite_report(finished.paths.path)


def test_what_cannot_be_repeated_is_refused_before_any_work() -> None:
    lags = ["detector.lag=0.1", "source.exposure_ms=20", "source.motion_samples=3"]
    with pytest.raises(InputError, match=r"evaluation\.tasks: with detector\.lag and source"):
        check_places(SimulationBuilder(scenario(*lags)))
    small = "evaluation.regions.0.shape.radius_mm=11"
    with pytest.raises(InputError, match=r"evaluation\.tasks\.0\.region: 'inner' holds no place"):
        check_places(SimulationBuilder(scenario(small)))


def test_without_a_scan_there_is_no_detectability() -> None:
    from twinct.runs import evaluate

    scan = simulate(scenario())
    told = evaluate(scan, reconstruct(scan)).further["tasks"]["spot"]
    assert math.isnan(told["detectability"])


def test_a_plan_and_a_run_stand_side_by_side(tmp_path: Path) -> None:
    (tmp_path / "views.csv").write_text("")
    plan = {"goals": {"detectability": {"planned": 7.5}}}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    of = scenario(f"task={{views: 6, detectability: {{signal: {SIGNAL}}}}}")
    path = type("File", (), {"path": tmp_path / "views.csv"})()
    planned = of.model_copy(update={"trajectory": path})
    image = {"tasks": {"spot": {"detectability": 6.0}}}
    assert planned_detectability(planned, image) == {
        "planned_detectability": {"predicted": 7.5, "measured": {"spot": 6.0}}
    }
    assert planned_detectability(of, image) == {}, "its views are no plan's"
    (tmp_path / "plan.json").write_text("{}")
    with pytest.raises(InputError, match="plan.json"):
        planned_detectability(planned, image)


def test_figures_that_reward_smoothing_are_never_shown_alone() -> None:
    cnr = "image_by_geometry.executed.contrasts.a_against_b"
    assert with_companions(["image.ssim", f"{cnr}.cnr", "views"]) == (
        "image.ssim",
        "image.signal_rel",
        "image.edge_width_mm",
        f"{cnr}.cnr",
        f"{cnr}.recovery",
        "image_by_geometry.executed.edge_width_mm",
        "views",
    )
