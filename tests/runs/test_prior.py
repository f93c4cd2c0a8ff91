"""A prior as a scenario names it: read, counted by content, refused before any work."""

import numpy as np
import pytest
from still_scans import still_scan, views_of

from twinct.core.errors import InputError, ScenarioError
from twinct.geometry import Pose, VolumeGrid
from twinct.recon import Projector, prior_tv, without_surroundings
from twinct.recon.registration import moved, registered, resampled
from twinct.recon.volume import Volume
from twinct.runs import line_integrals, reconstruct, require_feasible
from twinct.scenario import load_scenario, parse_scenario, stage_digests
from twinct.trajectory import commanded_views

GRID = VolumeGrid((24, 24, 24), 4.0)
POINTS = np.stack(np.meshgrid(*(GRID.axes()[::-1]), indexing="ij"))
TISSUE = np.where(np.sum((POINTS / [[[[30]]], [[[24]]], [[[36]]]]) ** 2, axis=0) < 1, 0.02, 0)


def settings(path, **reconstruction):
    keys = {
        "algorithm": "prior_tv",
        "iterations": 2,
        "grid": {"voxels": 24, "voxel_mm": 4.0},
        "prior": {"path": str(path)},
    }
    return {
        "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8.0},
        "trajectory": {"kind": "circle", "views": 8},
        "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 35}}]},
        "uncertainty": {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}},
        "reconstruction": keys | reconstruction,
    }


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "earlier.nii"
    Volume(TISSUE, GRID).write(path)
    return path


def scan_of(scenario):
    """Of the tissue, from where the scenario commands, in the whole grid's voxels."""
    return still_scan(scenario, np.exp(-Projector(views_of(scenario), GRID)(TISSUE)))


def test_the_scenario_says_all_of_it(file):
    prior = {"path": str(file), "share": 0.7, "position_mm": [1, 0, 0]}
    scenario = parse_scenario(settings(file, prior=prior, huber=0.1, weighting="counts"))
    scan = scan_of(scenario)
    A = Projector(scan.believed.geometry(scenario.detector.panel), GRID)
    expected = prior_tv(
        A,
        line_integrals(scan.transmission),
        Volume.read(file),
        iterations=2,
        regularisation=0.0,
        share=0.7,
        start=Pose.from_euler((1, 0, 0), (0, 0, 0)),
        huber=0.1,
        weights=scan.transmission,
    )
    found = reconstruct(scan)
    assert np.isfinite(found).all() and np.array_equal(found, expected)
    pose = found.extras["world_from_prior"]
    assert pose == expected.extras["world_from_prior"]
    told = found.extras["prior"]
    # The grid's middle is the world's origin, and was believed at (-1, 0, 0) mm of the prior's.
    assert told["moved_mm"] == pytest.approx(np.linalg.norm(pose.inverse().position + [1, 0, 0]))
    assert told["position_mm"] == pose.position.tolist() and 0 < told["turned_deg"] < 5
    words = scenario.reconstruction.in_words
    assert "prior earlier.nii with a share of 0.7" in words and "huber 0.1" in words


def test_what_lies_around_is_found_with_the_prior(file):
    """To the last bit what the parts give: without it, registered, with it."""
    around = {"margin_mm": 24.0, "voxel_mm": 8.0, "iterations": 3}
    grid = {"voxels": 12, "voxel_mm": 4.0}
    scenario = parse_scenario(settings(file, grid=grid, surroundings=around))
    scan = scan_of(scenario)
    A = Projector(
        scan.believed.geometry(scenario.detector.panel), scenario.reconstruction.volume_grid
    )
    p, prior = line_integrals(scan.transmission), Volume.read(file)
    pose = registered(A, without_surroundings(A, p, **around), prior)
    known = resampled(prior.array, moved(prior.grid, pose), A.grid, order=3)
    rest = without_surroundings(A, p, **around, expected=known)
    expected = prior_tv(A, rest, prior, iterations=2, regularisation=0.0)
    assert np.array_equal(reconstruct(scan), expected)


@pytest.mark.parametrize("rounds", [3, 0])
def test_rounds_without_a_pass_are_refused(file, rounds):
    with pytest.raises(ScenarioError, match="rounds"):
        parse_scenario(settings(file, rounds=rounds))


def test_a_prior_counts_by_its_content(file, tmp_path):
    scenario = parse_scenario(settings(file))
    assert scenario.files() == {"reconstruction.prior.path": file}
    first = stage_digests(scenario)
    other = tmp_path / "elsewhere.nii"
    file.rename(other)
    assert stage_digests(parse_scenario(settings(other))) == first
    Volume(TISSUE * 1.01, GRID).write(other)
    second = stage_digests(parse_scenario(settings(other)))
    assert [name for name in first if first[name] != second[name]] == ["volume"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path.write_text("no volume"), "the NIfTI volume cannot be read"),
        (lambda path: Volume(50_000 * TISSUE - 1000, GRID).write(path), "Hounsfield units"),
        (
            lambda path: Volume(
                TISSUE, VolumeGrid(GRID.shape, 4.0, Pose.from_euler((0, 99, 0), (0, 0, 0)))
            ).write(path),
            r"prior.path: .*earlier.nii: the prior does not overlap the grid: its centre is 99 mm",
        ),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(file, make, words):
    make(file)
    scenario = parse_scenario(settings(file))
    with pytest.raises(InputError, match=words):
        require_feasible(scenario, commanded_views(scenario.trajectory, scenario.detector.panel))


def test_a_prior_is_needed_and_has_to_be_there(tmp_path):
    with pytest.raises(ScenarioError, match="reconstruction.prior"):
        load_scenario(settings("x"), ["reconstruction={algorithm: prior_tv}"])
    with pytest.raises(ScenarioError, match=r"reconstruction\.prior\.path.*gone\.nii"):
        load_scenario(settings(tmp_path / "gone.nii"))
