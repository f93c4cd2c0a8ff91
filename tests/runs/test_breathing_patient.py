"""A patient who breathes: images, truth of each phase, gating, compensation, and bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import nibabel
import numpy as np
import pytest

from twinct import run
from twinct.core.errors import InputError, ScenarioError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.runs import reconstruct, simulate
from twinct.runs.known_motion import deformations, moving_voxels, views_that_count
from twinct.runs.reporting import evaluate
from twinct.runs.truth import truth_of
from twinct.scan import Scan, SimulationBuilder
from twinct.scenario import Scenario, load_scenario
from twinct.specimen.breathing import Breath

SCENARIO = Path(__file__).parents[2] / "scenarios" / "patient_breathing.yaml"
SMALL = (
    "specimen.parts.0.shape.voxel_mm=8",
    "detector={columns: 48, rows: 36, pixel_pitch_mm: 12}",
    "trajectory.views=20",
    "cell.view_s=0.37",
    "reconstruction.grid={voxels: [34, 26, 44], voxel_mm: 11}",
)


def small(*more: str) -> Scenario:
    return load_scenario(SCENARIO, [*SMALL, *more])


@pytest.fixture(scope="module")
def scan() -> Scan:
    return simulate(small())


def otherwise(scan: Scan, **motion: object) -> float:
    """RMSE where it moves, with another ``reconstruction.motion``."""
    volume = reconstruct(scan, motion=motion or None)
    return evaluate(scan, volume).as_dict()["rmse_moving_rel"]


def test_each_view_sees_its_own_time_and_each_instant_of_an_exposure_too(scan: Scan) -> None:
    builder = SimulationBuilder(small("source.exposure_ms=200", "source.motion_samples=2"))
    motion, pose = builder.specimen.motion, builder.specimen.world_from_specimen
    assert motion is not None
    with builder.imager() as imager:
        view = replace(builder.targets[0], object=(pose,))
        still = imager.expose(view, time_s=0.0)
        parts = [imager.expose(view, time_s=t).astype(float) for t in (0.95, 1.05)]
        blurred = imager.expose(PosePairs.joined([view] * 2), time_s=1.0)
        assert np.array_equal(still, imager.expose(view, time_s=0.0))
    assert np.abs(parts[0] - still).max() > 0.02
    assert np.abs(parts[1] - parts[0]).max() > 1e-4
    assert blurred == pytest.approx((parts[0] + parts[1]) / 2, abs=1e-6)
    times = 0.37 * np.arange(1, 21)
    assert scan.middle_s == pytest.approx(times)


def test_a_moved_body_is_that_of_a_specimen_that_stands_in_this_state(scan: Scan) -> None:
    """The truth of a phase, projected at rest, is the image of a view at its time."""
    builder = SimulationBuilder(small())
    built = builder.specimen
    assert built.motion is not None
    breath = built.motion.at(float(scan.middle_s[5]))
    stands = SimulationBuilder(small(), given_specimen=built.at(breath))
    with stands.imager() as imager:
        view = replace(builder.targets[5], object=(built.world_from_specimen,))
        image = imager.expose(view, 5)
    assert np.array_equal(image, scan.transmission[5])
    lung = "lung_right"
    before, after = (
        one.mixtures[0].points(lung, 10**6, np.random.default_rng(0))[:, 2].mean()
        for one in (built, built.at(Breath(0.5)))
    )
    assert after < before - 2, "the lung goes down"


def test_the_truth_has_the_phase_of_the_volume(scan: Scan) -> None:
    deep = small("reconstruction.motion={phase: 0.5}")
    at_rest, full = (
        truth_of(one, SimulationBuilder(one.scenario)).volume
        for one in (scan, scan.with_settings(deep))
    )
    motion = SimulationBuilder(deep).specimen.motion
    assert motion is not None
    moving = moving_voxels(motion, deep.reconstruction.volume_grid, Pose.identity())
    off = np.abs(full - at_rest)
    assert off[moving].mean() > 20 * off[~moving].mean() > 0
    assert 0.05 < moving.mean() < 0.5


@pytest.mark.tutorial
def test_a_known_motion_is_compensated_and_a_wrong_amplitude_in_part(scan: Scan) -> None:
    ignored = otherwise(scan, compensate=False)
    known = otherwise(scan, compensate=True)
    wrong = otherwise(scan, compensate=True, amplitude_rel=0.5)
    still = simulate(small("specimen.motion=null", "reconstruction.motion=null"))
    volume = reconstruct(still)
    rest = evaluate(still.with_settings(scan.scenario), volume)
    at_rest = rest.as_dict()["rmse_moving_rel"]
    assert at_rest < known < wrong < ignored
    assert known < at_rest + 0.3 * (ignored - at_rest)


def test_a_gate_takes_its_views_and_needs_one(scan: Scan) -> None:
    gate = "reconstruction.motion={compensate: false, gate: [0.8, 0.2]}"
    chosen = views_that_count(small(gate), scan.middle_s)
    motion = SimulationBuilder(small()).specimen.motion
    assert motion is not None and chosen is not None
    assert 3 < len(chosen) < 14
    for view, time_s in enumerate(scan.middle_s):
        assert (view in chosen) == (not 0.2 < motion.at(float(time_s)).phase < 0.8)
    volume = reconstruct(scan, motion={"compensate": False, "gate": (0.8, 0.2)})
    part = reconstruct(
        scan.with_settings(small("reconstruction.motion=null")),
        mask=np.isin(np.arange(20), chosen)[:, None, None] & np.ones((36, 48), bool),
    )
    assert np.corrcoef(volume.array.ravel(), part.array.ravel())[0, 1] > 0.99
    with pytest.raises(InputError, match=r"gate: none of the 1 views has a phase between 0.4"):
        views_that_count(
            small("reconstruction.motion={gate: [0.4, 0.5]}"), np.array([4.1 * 10 + 3.5])
        )


def test_believed_motion_is_late_and_scaled() -> None:
    scenario = small("reconstruction.motion={amplitude_rel: 0.8, delay_s: 0.3, phase: 0.25}")
    motion, known = SimulationBuilder(scenario).specimen.motion, scenario.reconstruction.motion
    assert motion is not None and known is not None
    (state,) = deformations(motion, known, np.array([1.3]), Pose.identity())
    point = np.array([[0.0, 30.0, -20.0]])
    way = 0.8 * motion.displacement(point, motion.at(1.0))
    held = point + 0.8 * motion.displacement(point, Breath(0.25))
    assert state.from_reference(held) == pytest.approx(point + way, abs=1e-3)
    assert state.to_reference(point + way) == pytest.approx(held, abs=1e-3)


def phases(folder: Path, size: float, count: int = 2, shape: tuple[int, ...] = (6, 6, 8)) -> str:
    """Files of fields; the second moves everything by ``size`` mm along z, wave-like."""
    affine = np.diag([-80.0, 80, 80, 1])
    affine[:3, 3] = 200, -200, -280
    for i in range(count):
        vectors = np.zeros((*shape, 1, 3), np.float32)
        vectors[..., 0, 2] = i * size * np.sin(np.arange(shape[2]))
        nibabel.save(nibabel.Nifti1Image(vectors, affine), folder / f"phase_{i}.nii")
    files = [{"path": str(folder / f"phase_{i}.nii")} for i in range(count)]
    return f"specimen.motion={json.dumps({'kind': 'fields', 'part': 'patient', 'phases': files})}"


def test_fields_of_the_users_own_move_the_patient(tmp_path: Path) -> None:
    motion = SimulationBuilder(small(phases(tmp_path, 10))).specimen.motion
    assert motion is not None
    place = np.array([[40.0, -40, -280 + 80 * 3]])
    moved = motion.deformation(Breath(0.5)).from_reference(place) - place
    assert moved[0] == pytest.approx([0, 0, 10 * np.sin(3)], abs=1e-6)
    assert not motion.displacements_mm(place, Breath(0.0)).any()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("specimen.motion.diaphragm_mm=300", "displacement field, phase 0.[0-9]+, folds at"),
        ("specimen.motion.part=table", "'table' is not the name of one grey part"),
        ("specimen.parts.0.shape.centre=true specimen.motion=FIELDS", "needs shape.centre: false"),
        ("reconstruction.algorithm=sirt", "sirt cannot compensate a motion"),
        ("specimen.motion=null", "reconstruction.motion needs a motion of the patient"),
        ("detector.lag=0.1", "detector.lag: the signal of the previous view"),
        ("reconstruction.motion.gate=[0.2,0.2]", "holds no phase"),
    ],
)
def test_bad_input_is_named(more: str, message: str, tmp_path: Path) -> None:
    fields = phases(tmp_path, 5).removeprefix("specimen.motion=")
    keys = [key.replace("FIELDS", fields) for key in more.split()]
    with pytest.raises((ScenarioError, InputError), match=message):
        SimulationBuilder(small(*keys)).specimen  # noqa: B018 - it is built


def test_fields_that_do_not_fit_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="specimen.motion: .* folds at"):
        SimulationBuilder(small(phases(tmp_path, 300))).specimen  # noqa: B018
    key = phases(tmp_path, 5)
    affine = np.diag([70.0, 70, 70, 1])
    vectors = np.zeros((6, 6, 8, 3), np.float32)
    nibabel.save(nibabel.Nifti1Image(vectors, affine), tmp_path / "phase_1.nii")
    with pytest.raises(InputError, match=r"phases\.1\.path: .*on another grid than the first"):
        SimulationBuilder(small(key)).specimen  # noqa: B018
    nibabel.save(nibabel.Nifti1Image(vectors[..., 0], affine), tmp_path / "phase_0.nii")
    with pytest.raises(InputError, match=r"phases\.0\.path: .*expected vectors"):
        SimulationBuilder(small(key)).specimen  # noqa: B018


def test_a_part_that_stands_still_in_moving_tissue_is_named() -> None:
    rod = {
        "name": "rod",
        "shape": {"kind": "cylinder", "radius_mm": 4, "height_mm": 30},
        "material": "titanium",
        "position_mm": [60, 0, -60],
    }
    told = small().model_dump(mode="json")["specimen"]["parts"]
    with pytest.raises(InputError, match=r"part 'rod' stands still where 'patient' moves by"):
        SimulationBuilder(small(f"specimen.parts={json.dumps([*told, rod])}")).specimen  # noqa: B018


@pytest.mark.tutorial
def test_a_run_compensates_and_reports_the_motion(tmp_path: Path) -> None:
    made = run(small(), tmp_path / "out", link="local")
    assert 0 < made.figures["image"]["rmse_moving_rel"] < 0.3
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "breathes about" in page and "motion compensated" in page
    assert "RMSE where it moves" in page
