"""The phantom of balls: where they are, and that they are there."""

import numpy as np
import trimesh

from twinct.scenario import BallHelix, Part, Specimen
from twinct.specimen import build_specimen
from twinct.specimen.balls import nominal_centres, true_centres

SHAPE = BallHelix(kind="ball_helix", tolerance_mm=0.05, tolerance_seed=3, mesh_resolution_mm=0.5)


def test_no_run_of_gaps_comes_twice():
    steps = np.linalg.norm(np.diff(nominal_centres(SHAPE), axis=0), axis=1)
    wide = steps > steps.mean()
    runs = [tuple(wide[i : i + 6]) for i in range(len(wide) - 5)]
    assert len(set(runs)) == len(runs)


def test_balls_are_off_by_their_tolerance():
    off = true_centres(SHAPE) - nominal_centres(SHAPE)
    assert 0.04 < off.std() < 0.06
    again = BallHelix(kind="ball_helix", tolerance_mm=0.05, tolerance_seed=4)
    assert not np.array_equal(true_centres(again), true_centres(SHAPE))


def test_the_mesh_is_balls_at_their_true_places():
    specimen = build_specimen(Specimen(parts=(Part(shape=SHAPE, material="steel"),)))
    mesh = specimen.parts[0].mesh
    assert mesh.is_watertight
    balls = mesh.split()
    assert len(balls) == 64
    centres = np.array([ball.center_mass for ball in balls])
    far = np.linalg.norm(centres[:, None] - true_centres(SHAPE), axis=2).min(axis=0)
    assert far.max() < 1e-6
    assert np.isclose(mesh.volume, 64 * trimesh.creation.icosphere(6, 1.5).volume, rtol=1e-2)
