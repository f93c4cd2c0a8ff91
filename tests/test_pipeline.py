"""The whole job in one process with the real engines, on a scan small enough for a test."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twinct import pipeline
from twinct.evaluate import pose_errors
from twinct.pipeline import judge, line_integrals, reconstruct, simulate, truth_of
from twinct.scan import Scan, Workshop
from twinct.scenario import Scenario, load_scenario

SCENARIOS = Path(__file__).parents[1] / "scenarios"
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
def workshop(scenario: Scenario) -> Workshop:
    return Workshop(scenario)


@pytest.fixture(scope="module")
def scan(scenario: Scenario, workshop: Workshop) -> Scan:
    return simulate(scenario, workshop=workshop)


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
    truth = truth_of(scan, Workshop(scenario))
    good = judge(scan, reconstruct(scan), truth).rmse_rel
    bad = judge(other, reconstruct(other), truth).rmse_rel
    exact = judge(other, reconstruct(other, geometry="executed"), truth).rmse_rel
    assert bad > 1.1 * good
    assert exact == pytest.approx(good, rel=0.05)


def test_volume_has_the_ball_in_its_place(scenario: Scenario, scan: Scan) -> None:
    volume = reconstruct(scan)
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


def test_a_scan_is_a_function_of_scenario_and_seed(scenario: Scenario, scan: Scan) -> None:
    again = simulate(scenario)
    np.testing.assert_array_equal(again.transmission, scan.transmission)
    assert again.believed.source == scan.believed.source
    reseeded = simulate(scenario.model_copy(update={"seed": 99}))
    np.testing.assert_array_equal(reseeded.transmission, scan.transmission)
    assert reseeded.believed.source != scan.believed.source


def test_reconstruction_goes_on_from_its_checkpoint(scan: Scan, tmp_path, monkeypatch) -> None:
    whole = reconstruct(scan)
    kept = pipeline._Checkpoints.keep

    def killed(self, iterations, volume) -> None:
        kept(self, iterations, volume)
        if iterations == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(pipeline._Checkpoints, "keep", killed)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(scan, checkpoints=tmp_path)
    assert [p.name.rpartition("-")[2] for p in tmp_path.iterdir()] == ["0002.npy"]
    np.testing.assert_array_equal(reconstruct(scan, checkpoints=tmp_path), whole)


def test_opaque_pixels_give_finite_line_integrals() -> None:
    integrals = line_integrals(np.array([[1.0, 0.5, 0.0]], dtype=np.float32))
    np.testing.assert_allclose(integrals[0, :2], [0, np.log(2)], rtol=1e-6)
    assert 16 < integrals[0, 2] < 17
