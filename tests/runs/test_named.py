"""Figures of named regions: in volumes made for them, and in runs, where no volume is made anew."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from twinct import run
from twinct.core.errors import InputError
from twinct.evaluation import Repeated, figure_kinds
from twinct.geometry import Pose, VolumeGrid
from twinct.runs import Run, reconstruct_run, rewrite_report
from twinct.runs.checks import check_places
from twinct.runs.regions import Places
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario
from twinct.specimen import build_specimen
from twinct.specimen.signals import AnySignal, contrast_at
from twinct.study.trial_figures import figure_names, flat_figures

Tiny = Callable[..., Scenario]
DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
ENERGY = 80.0
NOISE, BLUR_MM = 0.05, 1.0

KEYS = [
    "reconstruction.grid={voxels: 96, voxel_mm: 1}",
    "specimen.position_mm=[3, -2, 1]",
    "specimen.rotation_deg=[0, 0, 30]",
    """specimen.parts=[
      {name: water, shape: {kind: cylinder, radius_mm: 42, height_mm: 90}, material: water},
      {name: ball.1, shape: {kind: sphere, radius_mm: 10}, position_mm: [20, 0, 0]},
      {name: rod, shape: {kind: cylinder, radius_mm: 5, height_mm: 40}, position_mm: [-22, 0, 0],
       rotation_deg: [30, 0, 0]}
    ]""",
    """evaluation={
      regions: [
        {name: ball, shape: {kind: sphere, radius_mm: 6}, position_mm: [20, 0, 0]},
        {name: water_box, shape: {kind: box, size_mm: [30, 14, 40]}, position_mm: [0, 27, 0]},
        {name: about, shape: {kind: shell, part: rod, from_mm: 4, to_mm: 8}}
      ],
      contrasts: [{region: ball, against: water_box}],
      mtf: [{at: ball.1}, {at: rod}],
      nps: [{region: water_box}],
      hounsfield: [{region: water_box}],
      tasks: [
        {name: sharp, signal: {kind: sphere, radius_mm: 4, contrast_rel: 0.1}, region: water_box},
        {name: soft, signal: {kind: gaussian, sigma_mm: 2, contrast_rel: 0.1}, region: water_box,
         scans: 3}
      ],
      streaks: [{part: rod, from_mm: 4, to_mm: 10}]
    }""",
]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(DEMO, KEYS)


@pytest.fixture(scope="module")
def places(scenario: Scenario) -> Places:
    specimen = build_specimen(scenario.specimen)
    grid = scenario.reconstruction.grid.volume_grid
    return Places(scenario, specimen, specimen.world_from_specimen, grid)


@pytest.fixture(scope="module")
def found(places: Places) -> dict:
    """In a volume that is the truth, blurred, with white noise and a wave about the rod."""
    mu = places.specimen.reference_mu(ENERGY)
    truth = places.specimen.truth(places.grid, ENERGY)
    about = places.region("about")
    frame = places.world_from_specimen @ Pose.from_euler((-22, 0, 0), (30, 0, 0))
    at = frame.inverse().apply(about.points(places.grid))
    wave = np.zeros(truth.shape)
    wave[about.box][about.mask] = 0.2 * mu * np.cos(2 * np.arctan2(at[:, 1], at[:, 0]))

    def made(true: np.ndarray, scan: int) -> np.ndarray:
        noise = NOISE * mu * np.random.default_rng([3, scan]).standard_normal(truth.shape)
        return (ndimage.gaussian_filter(true, BLUR_MM) + noise + wave).astype(np.float32)

    def again(signal: AnySignal, centres_mm: np.ndarray, scans: int) -> Repeated:
        marked = truth.astype(np.float64)
        for centre in centres_mm:
            x, y, z = (a - c for a, c in zip(places.grid.axes(), centre, strict=True))
            radius = np.sqrt(z[:, None, None] ** 2 + y[:, None] ** 2 + x**2)
            marked += mu * contrast_at(signal, radius, 1.0)
        return Repeated([made(truth, scan) for scan in range(scans)], made(marked, 0))

    return places.figures(made(truth, 0), truth, mu, again=again)


def test_they_are_those_that_were_promised(scenario: Scenario, places: Places, found: dict) -> None:
    assert scenario.evaluation is not None and not places.check()
    dotted = {
        f"{kind}.{name}.{figure}"
        for kind, names in found.items()
        for name, figures in names.items()
        for figure, value in figures.items()
        if np.ndim(value) == 0
    }
    assert dotted == set(scenario.evaluation.figure_names())
    assert set(found) == set(figure_kinds()) and "mtf.ball_1.f50_per_mm" in dotted


def test_what_lies_outside_of_a_grid_has_no_figures(places: Places, found: dict) -> None:
    """As of a zoom into another place."""
    there = Pose.from_euler((500, 0, 0), (0, 0, 0))
    grid = VolumeGrid((12, 12, 12), places.grid.voxel, there)
    elsewhere = replace(places, grid=grid).figures(*np.zeros((2, *grid.shape), np.float32), 0.02)
    for kind, names in found.items():
        for name, figures in names.items():
            single = {key for key, value in figures.items() if np.ndim(value) == 0}
            nothing = elsewhere[kind][name]
            assert set(nothing) == single and np.isnan([*nothing.values()]).all(), kind


def test_regions_and_their_contrast(places: Places, found: dict) -> None:
    bone, water = (part.material.mu_per_mm(ENERGY) for part in places.specimen.parts[1::-1])
    mu = places.specimen.reference_mu(ENERGY)
    assert mu == water, "the largest part"
    regions = found["regions"]
    assert regions["ball"]["mean_rel"] == pytest.approx(bone / water, rel=0.01)
    assert regions["water_box"]["mean_rel"] == pytest.approx(1, rel=0.01)
    assert abs(regions["water_box"]["bias_rel"]) < 0.002
    assert regions["water_box"]["rmse_rel"] == pytest.approx(NOISE, rel=0.03)
    contrast = found["contrasts"]["ball_against_water_box"]
    assert contrast["recovery"] == pytest.approx(1, rel=0.01)
    assert contrast["contrast_rel"] == pytest.approx(bone / water - 1, rel=0.01)
    assert contrast["cnr"] == pytest.approx((bone / water - 1) / NOISE, rel=0.03)


@pytest.mark.parametrize("body", ["ball_1", "rod"])
def test_transfer_is_that_of_blur_and_voxel(found: dict, body: str) -> None:
    transfer = found["mtf"][body]
    f = transfer["frequency_per_mm"]
    # The truth is a mean over voxels of 1 mm: sinc(f) along an axis, less across it.
    gauss = np.exp(-2 * (np.pi * BLUR_MM * f) ** 2)
    expected = gauss * np.sinc(f) ** 0.9
    strong = expected > 0.1
    assert np.abs(transfer["mtf"] - expected)[strong].max() < 0.05
    assert transfer["f50_per_mm"] < transfer["f10_per_mm"] < 0.5


def test_noise_and_what_can_be_seen_in_it(places: Places, found: dict) -> None:
    noise = found["nps"]["water_box"]
    assert noise["noise_rel"] == pytest.approx(NOISE, rel=0.03)
    power = noise["nps_mm3"][3:]
    assert np.median(power) == pytest.approx(NOISE**2, rel=0.1)
    # Blur of the signal by a Gaussian, but none of the white noise:
    # d'^2 is the energy of the blurred signal over the variance of the noise.
    x = np.indices((41,) * 3) - 20.0
    radius = np.sqrt((x**2).sum(axis=0))
    entries = {one.name: one for one in places.section.entries("tasks")}
    for name, figures in found["tasks"].items():
        signal = ndimage.gaussian_filter(contrast_at(entries[name].signal, radius, 1.0), BLUR_MM)
        expected = math.sqrt((signal**2).sum()) / NOISE
        assert figures["detectability_quantum"] == pytest.approx(expected, rel=0.07)
        low, high = figures["detectability_low"], figures["detectability_high"]
        assert low < figures["detectability"] < high
        # There is no texture; the intervals are of 95 %, and these draws are within them.
        assert low < expected < high


def test_streaks_about_the_rod(found: dict) -> None:
    # About a rod of 5 mm the wave fills 4 to 8 of the shell's 4 to 10 mm.
    share = (13**2 - 9**2) / (15**2 - 9**2)
    assert found["streaks"]["rod"]["streak_rel"] == pytest.approx(
        share * 0.2 / math.sqrt(2), rel=0.1
    )


def test_what_the_grid_does_not_hold_is_told_before_any_work(scenario: Scenario) -> None:
    def told(*keys: str) -> list[str]:
        other = load_scenario(DEMO, [*KEYS, *keys])
        with pytest.raises(InputError) as caught:
            check_places(SimulationBuilder(other))
        return list(caught.value.problems)

    (away,) = told("evaluation.regions.1.position_mm=[0, 500, 0]")
    assert away == "evaluation.regions.1: 'water_box' covers no voxel of the grid"
    part = "specimen.parts.2.position_mm=[0, 0, 400]"
    assert [problem.split(":")[0] for problem in told(part)] == [
        "evaluation.regions.2.shape.part",
        "evaluation.streaks.0.part",
        "evaluation.mtf.1.at",
    ]
    small = "specimen.parts.1.shape.radius_mm=1.5"
    assert (
        "evaluation.mtf.0.at: 'ball.1' has a radius of 1.5 mm; its edge needs at least 2 mm"
        in (told(small)[0])
    )
    check_places(SimulationBuilder(scenario))


def test_a_body_without_contrast_has_no_transfer_and_stops_nobody(places: Places) -> None:
    flat = np.ones(places.grid.shape, np.float32)
    found = places.figures(flat, flat, 1.0)
    assert math.isnan(found["mtf"]["rod"]["f50_per_mm"])
    assert math.isnan(found["tasks"]["soft"]["detectability"])


ASKED = "evaluation={regions: [{name: middle, shape: {kind: sphere, radius_mm: 30}}]}"
MORE = """evaluation={
  regions: [{name: middle, shape: {kind: sphere, radius_mm: 25}}],
  nps: [{region: middle}], mtf: [{at: sphere}]
}"""


def test_other_figures_make_no_volume_anew(
    finished: Run, tiny: Tiny, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twinct.runs.job.reconstruct", lambda *_, **__: 1 / 0)
    monkeypatch.setattr(
        "twinct.runs.reconstruction.rewrite_report", lambda *_: None
    )  # which takes seconds
    monkeypatch.setattr("twinct.runs.reporting._room", lambda _: None)
    out = shutil.copytree(finished.paths.path, tmp_path / "out")
    beside = ["reconstruction.algorithm=cgls", "reconstruction.grid={voxels: 12, voxel_mm: 12}"]
    reconstruct_run(out, beside, name="beside")
    volumes = [out / "volume.nii", out / "reconstructions" / "beside" / "volume.nii"]
    before = [path.read_bytes() for path in volumes]
    again = rewrite_report(out, overrides=[ASKED])
    for figures in (again.figures["image"], again.figures["reconstructions"]["beside"]["image"]):
        assert 0.5 < figures["regions"]["middle"]["mean_rel"] < 1.5
    assert again.figures["image"]["rmse_rel"] == finished.figures["image"]["rmse_rel"]
    assert [path.read_bytes() for path in volumes] == before
    # The folder knows what was asked; a run that asks for more measures, and takes nothing anew.
    resumed = run(tiny(MORE), out, link="local", resume=True)
    image = resumed.figures["image"]
    assert image["nps"]["middle"]["noise_rel"] > 0 and len(image["mtf"]["sphere"]["mtf"]) > 9
    assert [path.read_bytes() for path in volumes] == before
    names = {name for name in figure_names(resumed.scenario) if not name.startswith("geometries")}
    assert names <= set(flat_figures(resumed.figures)), "a study can name them"
    assert not [name for name in flat_figures(resumed.figures) if name.endswith(".mtf")]
    page = resumed.paths.report.read_text(encoding="utf-8")
    assert page.count("Regions and tasks") == 1 and page.count("Modulation transfer") >= 1
    told = json.loads(resumed.paths.metrics.read_text())
    assert told["image"] == image
    with pytest.raises(InputError, match="only keys of evaluation can be changed here"):
        rewrite_report(out, overrides=["reconstruction.iterations=3"])
    with pytest.raises(InputError, match="unknown region 'x'"):
        rewrite_report(out, overrides=["evaluation.nps=[{region: x}]"])


def test_figures_that_every_run_has(finished: Run) -> None:
    image = finished.figures["image"]
    assert image["zero"]["rmse_rel"] > 0.1 and image["zero"]["ssim"] < 1
    depth = image["rmse_rel_by_depth"]
    assert list(depth)[0] == "0_to_5_mm" and any(depth.values())
    assert "edge_width_mm" in image and "ssim_near" in image
    assert "believed_minus_executed" not in finished.figures
