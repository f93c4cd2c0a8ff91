"""The whole job in one process with the real engines, on a scan small enough for a test."""

from __future__ import annotations

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError, MemoryShortageError
from twinct.evaluation import pose_errors
from twinct.geometry import Pose
from twinct.recon import Projector, cgls, os_sart, random_order, sart, sirt
from twinct.runs import (
    judge,
    line_integrals,
    machine_frames,
    reconstruct,
    require_feasible,
    simulate,
    truth_of,
    volumes,
)
from twinct.runs.checkpoints import Checkpoints
from twinct.runs.integrals import hardening_corrected
from twinct.scan import Scan, SimulationBuilder
from twinct.scenario import Scenario, load_scenario, parse_scenario
from twinct.xray.build import effective_energy_kev

SCENARIOS = Path(__file__).parents[2] / "scenarios"
BALL_MM = np.array([20.0, -30.0, 40.0])

TINY = [
    "trajectory.views=8",
    "detector={columns: 64, rows: 48, pixel_pitch_mm: 5}",
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 12}, position_mm: [20, -30, 40]}]",
    "reconstruction.grid={voxels: 32, voxel_mm: 5}",
    "reconstruction.iterations=3",
]

ENTRY_MM = 1.0
"""The scenario's tolerance: an executed pose is nearer than this to the commanded one."""

CENTROID_PX = 0.12
"""A sphere's shadow is off its centre's projection by its perspective (below 0.06 px here) and by
the sampling of its edge."""


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(SCENARIOS / "demo.yaml", TINY)


@pytest.fixture(scope="module")
def builder(scenario: Scenario) -> SimulationBuilder:
    return SimulationBuilder(scenario)


@pytest.fixture(scope="module")
def scan(scenario: Scenario, builder: SimulationBuilder) -> Scan:
    return simulate(scenario, builder=builder)


def test_a_scan_is_shown_in_one_line(scan: Scan) -> None:
    assert repr(scan) == "Scan('demo', 8 views, 64 x 48 px)"


def test_three_geometries_stand_apart(scan: Scan) -> None:
    errors = pose_errors(scan.commanded, scan.executed)
    for arm in (errors.source, errors.detector):
        assert 0.05 < arm.position_mm.max() < ENTRY_MM
    for name in ("source", "detector"):
        for executed, believed in zip(
            getattr(scan.executed, name), getattr(scan.believed, name), strict=True
        ):
            offset = np.abs(believed.position - executed.position)
            assert 0 < offset.max() <= 0.15
            np.testing.assert_array_equal(believed.quat, executed.quat)
    assert np.all(np.diff(scan.simulated_s) > 0)
    assert scan.clearance_mm.min() >= scan.scenario.motion.clearance_mm


def test_images_are_made_with_the_executed_geometry(scenario: Scenario, scan: Scan) -> None:
    """The shadow of an off-centre ball lies where the executed geometry projects it."""
    panel = scenario.detector.panel
    integrals = line_integrals(scan.transmission)
    columns, rows = np.meshgrid(np.arange(panel.columns), np.arange(panel.rows))
    executed = scan.executed.geometry(panel).project([BALL_MM])[:, 0]
    for view, image in enumerate(integrals):
        centroid = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
        np.testing.assert_allclose(centroid, executed[view], atol=CENTROID_PX)


def test_belief_changes_the_volume_and_never_the_images(scenario: Scenario, scan: Scan) -> None:
    lost = scenario.model_copy(
        update={
            "uncertainty": scenario.uncertainty.model_copy(
                update={
                    "source": scenario.uncertainty.source.model_copy(
                        update={"sigma_mm": 20.0, "cutoff_mm": 30.0}
                    )
                }
            )
        }
    )
    other = simulate(lost)
    np.testing.assert_array_equal(other.transmission, scan.transmission)
    truth = truth_of(scan, SimulationBuilder(scenario))
    good = judge(scan, reconstruct(scan), truth).rmse_rel
    bad = judge(other, reconstruct(other), truth).rmse_rel
    exact = judge(other, reconstruct(other, geometry="executed"), truth).rmse_rel
    assert bad > 1.1 * good
    assert exact == pytest.approx(good, rel=0.05)


def test_volume_has_the_ball_in_its_place(scenario: Scenario, scan: Scan) -> None:
    volume = reconstruct(scan).array
    x, y, z = scenario.reconstruction.grid.volume_grid.axes()
    weight = np.where(volume > 0.3 * volume.max(), volume, 0)
    centre = (
        np.array(
            [
                (weight.sum(axis=(0, 1)) @ x),
                (weight.sum(axis=(0, 2)) @ y),
                (weight.sum(axis=(1, 2)) @ z),
            ]
        )
        / weight.sum()
    )
    np.testing.assert_allclose(centre, BALL_MM, atol=5.0)  # one voxel, from eight views


@pytest.mark.tutorial
def test_a_scan_is_a_function_of_scenario_and_seed(scenario: Scenario, scan: Scan) -> None:
    again = simulate(scenario)
    np.testing.assert_array_equal(again.transmission, scan.transmission)
    assert again.believed.source == scan.believed.source
    reseeded = simulate(scenario.model_copy(update={"seed": 99}))
    np.testing.assert_array_equal(reseeded.transmission, scan.transmission)
    assert reseeded.believed.source != scan.believed.source


def test_reconstruction_goes_on_from_its_checkpoint(scan: Scan, tmp_path, monkeypatch) -> None:
    whole = reconstruct(scan)
    kept = Checkpoints.keep

    def killed(self, iterations, volume, residuals) -> None:
        kept(self, iterations, volume, residuals)
        if iterations == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "keep", killed)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(scan, checkpoints=tmp_path)
    assert [p.name.rpartition("-")[2] for p in tmp_path.iterdir()] == ["0002.npz"]
    np.testing.assert_array_equal(reconstruct(scan, checkpoints=tmp_path), whole)


ALGORITHMS = {
    "sart": (["order=random"], None),
    "os_sart": (
        ["subsets=4", "nonnegative=true"],
        lambda A, p: os_sart(A, p, iterations=3, relaxation=0.3, subsets=4, nonnegative=True),
    ),
    "sirt": (["relaxation=1.2"], lambda A, p: sirt(A, p, iterations=3, relaxation=1.2)),
    "cgls": ([], lambda A, p: cgls(A, p, iterations=3)),
}


def with_keys(scan: Scan, *keys: str) -> Scan:
    overrides = [*TINY, *(f"reconstruction.{key}" for key in keys)]
    return scan.with_settings(load_scenario(SCENARIOS / "demo.yaml", overrides))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_scenario_selects_algorithm_and_parameters(scan: Scan, algorithm: str) -> None:
    keys, expected = ALGORITHMS[algorithm]
    chosen = with_keys(scan, f"algorithm={algorithm}", *keys)
    residuals: list[tuple[int, float]] = []
    volume = reconstruct(chosen, watch=lambda *pair: residuals.append(pair))
    geometry = scan.believed.geometry(scan.scenario.detector.panel)
    A = Projector(geometry, scan.scenario.reconstruction.grid.volume_grid)
    p = line_integrals(scan.transmission)
    if expected is not None:
        np.testing.assert_array_equal(volume, expected(A, p))
    else:
        # A permutation that the scenario's seed draws, again and again the same.
        np.testing.assert_array_equal(volume, reconstruct(chosen))
        rng = volumes.view_rng(scan.scenario.seed, "order of views", 0)
        order = random_order(len(scan), rng)
        drawn = sart(A, p, iterations=3, relaxation=0.3, order=order)
        np.testing.assert_array_equal(volume, drawn)
    assert [number for number, _ in residuals] == [1, 2, 3]
    assert residuals[-1][1] < residuals[0][1]


def test_residuals_and_random_order_go_on_from_a_checkpoint(scan: Scan, tmp_path) -> None:
    chosen = with_keys(scan, "algorithm=sart", "order=random")
    whole: list[float] = []
    volume = reconstruct(chosen, watch=lambda _, residual: whole.append(residual))

    def killed(number: int, _: float) -> None:
        if number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(chosen, checkpoints=tmp_path, watch=killed)
    seen: list[float] = []
    again = reconstruct(
        chosen, checkpoints=tmp_path, watch=lambda _, residual: seen.append(residual)
    )
    np.testing.assert_array_equal(again, volume)
    assert seen == whole


def test_surroundings_and_mask_are_passed_on(scan: Scan) -> None:
    plain = reconstruct(scan)
    around = with_keys(scan, "surroundings={margin_mm: 20, voxel_mm: 10}")
    assert not np.array_equal(reconstruct(around), plain)
    mask = np.ones(scan.transmission.shape[1:], np.bool_)
    mask[:, 30] = False
    broken = replace(around, transmission=np.where(mask, scan.transmission, np.nan))
    assert np.isfinite(reconstruct(broken, mask=mask).array).all()


def test_what_cannot_be_done_is_refused_before_work(
    scenario: Scenario, builder: SimulationBuilder
) -> None:
    def changed(*keys: str) -> Scenario:
        return load_scenario(SCENARIOS / "demo.yaml", [*TINY, *keys])

    views = builder.commanded
    require_feasible(scenario, views)
    with pytest.raises(InputError, match="fdk needs a circular scan"):
        require_feasible(changed("reconstruction={algorithm: fdk}"), views)
    with pytest.raises(InputError, match="behind the source"):
        require_feasible(changed("reconstruction.grid.voxel_mm=30"), views)
    large = changed("reconstruction={algorithm: fista_tv, grid: {voxels: 512, voxel_mm: 0.31}}")
    limits = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**30, limits[1]))
    try:
        with pytest.raises(MemoryShortageError, match=r"fista_tv .* needs 2\.\d\d GiB of memory"):
            require_feasible(large, views)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.mark.tutorial
def test_fdk_reconstructs_what_the_arms_scanned_on_an_arc() -> None:
    scenario = load_scenario(
        SCENARIOS / "demo.yaml",
        [
            *TINY,
            "trajectory={kind: arc, views: 40, longitude_range_deg: 212}",
            "reconstruction={algorithm: fdk, window: hann, grid: {voxels: 32, voxel_mm: 5}}",
        ],
    )
    builder = SimulationBuilder(scenario)
    require_feasible(scenario, builder.commanded)
    scan = simulate(scenario, builder=builder)
    figures = judge(scan, reconstruct(scan), truth_of(scan, builder))
    iterated = reconstruct(scan.with_settings(load_scenario(SCENARIOS / "demo.yaml", TINY)))
    assert figures.rmse_rel < 1.5 * judge(scan, iterated, truth_of(scan, builder)).rmse_rel


def test_opaque_pixels_give_finite_line_integrals() -> None:
    integrals = line_integrals(np.array([[1.0, 0.5, 0.0]], dtype=np.float32))
    np.testing.assert_allclose(integrals[0, :2], [0, np.log(2)], rtol=1e-6)
    assert 16 < integrals[0, 2] < 17


@pytest.mark.parametrize("blur", [False, True])
def test_raw_images_are_those_that_the_transmission_came_from(blur):
    physics = {
        "source": {"spectrum": {"kind": "tube", "kvp": 80}, "motion_samples": 2 if blur else 1},
        "detector": {
            **{"columns": 32, "rows": 24, "pixel_pitch_mm": 10.0, "noise": {"kind": "quantum"}},
            **{"readout": {"electronic_noise": 4.0}, "lag": 0.0 if blur else 0.1},
        },
        "trajectory": {"kind": "arc", "views": 3, "longitude_range_deg": 10},
        "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 60}}]},
    }
    builder = SimulationBuilder(parse_scenario(physics))
    scan = simulate(builder.scenario, builder=builder)
    frames = list(machine_frames(scan, builder, range(3)))
    for frame, transmission in zip(frames, scan.transmission, strict=True):
        np.testing.assert_array_equal(frame.transmission, transmission)
        light = np.maximum(frame.raw - frame.dark, 0.5) / (frame.flat - frame.dark)
        np.testing.assert_allclose(light, transmission, rtol=1e-6)
    assert not np.array_equal(frames[0].raw, frames[1].raw)


@pytest.mark.parametrize(
    "kind", ["one_material", pytest.param("two_materials", marks=pytest.mark.tutorial)]
)
def test_hardened_line_integrals_are_brought_to_one_energy(kind):
    """A ball of bone in water, without robots, against an image of one energy."""
    ball, core = (
        {"shape": {"kind": "sphere", "radius_mm": r}, "material": m}
        for r, m in ((50, "water"), (15, "bone"))
    )
    hardening = {"kind": kind} | (
        {"base": "water", "first_iterations": 5} if kind == "two_materials" else {}
    )
    scenario = parse_scenario(
        {
            "source": {"spectrum": {"kind": "tube", "kvp": 80}},
            "detector": {"columns": 64, "rows": 48, "pixel_pitch_mm": 5.0},
            "trajectory": {"kind": "circle", "views": 24},
            "specimen": {"parts": [ball] if kind == "one_material" else [ball, core]},
            "reconstruction": {"grid": {"voxels": 48, "voxel_mm": 3}, "beam_hardening": hardening},
        }
    )
    builder = SimulationBuilder(scenario)
    geometry = builder.commanded
    with builder.imager() as imager:
        images = np.stack([imager.render(view, Pose.identity()) for view in geometry])
    A = Projector(geometry, scenario.reconstruction.grid.volume_grid)
    found = hardening_corrected(scenario, line_integrals(images), A)
    ideal = parse_scenario(
        scenario.model_dump(mode="json", exclude={"source", "reconstruction"})
        | {"source": {"energy_kev": effective_energy_kev(scenario.source, scenario.detector)}}
    )
    with SimulationBuilder(ideal).imager() as imager:
        truth = line_integrals(np.stack([imager.render(v, Pose.identity()) for v in geometry]))
    raw = line_integrals(images)
    dark = truth > 0.5 * truth.max()
    errors = [np.abs(p - truth)[dark].mean() / truth[dark].mean() for p in (raw, found)]
    assert errors[0] > 0.015
    assert errors[1] < (0.002 if kind == "one_material" else 0.5 * errors[0])
