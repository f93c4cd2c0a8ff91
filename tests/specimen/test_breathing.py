"""Breathing: its rhythm, its displacements, and fields of the user's own."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Pose, VolumeGrid
from twinct.specimen.breathing import (
    Breath,
    Chest,
    PhaseFields,
    Rhythm,
    gated,
    require_smooth,
)
from twinct.specimen.deformation import Deformation

BOUNDS = np.array([[-165.0, -115.0, -235.0], [165.0, 115.0, 235.0]])
STATES = [Breath(phase) for phase in np.linspace(0, 1, 9)[:-1]]


def test_a_regular_rhythm_repeats_and_an_irregular_one_has_its_seed():
    steady = Rhythm(period_s=4.0)
    assert steady.at(9.0) == Breath(0.25)
    assert steady.at(8.0).phase == 0.0
    wild = Rhythm(period_s=4.0, irregularity=0.15, seed=3)
    times = np.arange(0, 400, 0.1)
    states = [wild.at(t) for t in times]
    assert states == [wild.at(t) for t in times]
    assert states != [Rhythm(4.0, 0.15, seed=4).at(t) for t in times]
    starts = times[1:][np.diff([s.phase for s in states]) < 0]
    assert np.diff(starts).std() == pytest.approx(0.15 * 4, rel=0.35)
    assert np.std(list({s.depth for s in states})) == pytest.approx(0.15, rel=0.35)
    assert Rhythm(drift_per_min=0.1).at(90.0).drift == pytest.approx(0.15)


def test_displacements_are_continuous_over_time_between_breaths_too():
    wild, chest = Rhythm(4.0, irregularity=0.3, drift_per_min=0.2, seed=1), Chest()
    points = np.random.default_rng(0).uniform(BOUNDS[0], BOUNDS[1], (50, 3))
    course = np.array([chest(points, wild.at(t)) for t in np.arange(0, 40, 0.02)])
    assert np.abs(np.diff(course, axis=0)).max() < 0.02 * 15 * 2.5 * np.exp(0.9)


def test_the_diaphragm_moves_most_and_spine_and_skin_hardly():
    chest, full = Chest(diaphragm_mm=15, front_mm=6), Breath(0.5)
    dome, spine, front, side, hip = chest(
        np.array([(0, 25, -20), (0, -60, -20), (0, 100, -20), (160, 0, 0), (0, 10, -230)], float),
        full,
    )
    assert dome[2] == pytest.approx(-15, abs=0.5)
    assert np.abs(spine).max() < 0.5
    assert front[1] == pytest.approx(6, abs=1.5)
    assert abs(front[2]) < 1.5
    assert np.abs(side).max() < 1.5
    assert np.abs(hip[2]) < 0.5
    assert not chest(np.zeros((1, 3)), Breath(0.0)).any()


def test_hysteresis_opens_a_loop():
    point = np.array([[0.0, 90.0, 0.0]])
    for share, least in ((0.0, 0.0), (0.2, 1.0)):
        chest = Chest(hysteresis=share)
        way_in, way_out = chest(point, Breath(0.3)), chest(point, Breath(0.7))
        assert abs(way_in - way_out).max() >= least
        assert share or np.allclose(way_in, way_out)


def test_a_displacement_has_its_inverse_and_a_fold_is_refused():
    pose = Pose.from_euler((3, 5, -20), (90, 0, 10))
    moved = Deformation(partial(Chest(diaphragm_mm=25), breath=Breath(0.45, 1.3, 0.1)), pose)
    points = pose.apply(np.random.default_rng(1).uniform(BOUNDS[0], BOUNDS[1], (300, 3)))
    assert moved.to_reference(moved.from_reference(points)) == pytest.approx(points, abs=1e-4)
    assert require_smooth(Chest(), STATES, BOUNDS, "breathing") > 0.6
    with pytest.raises(InputError, match=r"breathing, phase 0\.\d+, folds at"):
        require_smooth(Chest(diaphragm_mm=200), STATES, BOUNDS, "breathing")


def test_fields_of_phases_are_linear_in_phase_and_space():
    grid = VolumeGrid((5, 6, 7), 50.0, Pose.from_euler((10, 0, 0), (0, 0, 0)))
    vectors = np.random.default_rng(2).normal(0, 3, (4, 5, 6, 7, 3))
    fields = PhaseFields(vectors, grid.affine)
    node = (grid.affine @ [2, 3, 1, 1])[None, :3]
    for phase, expected in (
        (0.25, vectors[1, 1, 3, 2]),
        (0.875, (vectors[3, 1, 3, 2] + vectors[0, 1, 3, 2]) / 2),
    ):
        assert fields(node, Breath(phase))[0] == pytest.approx(expected)
    assert fields(node, Breath(0.25, 1.5))[0] == pytest.approx(1.5 * vectors[1, 1, 3, 2])
    between = (grid.affine @ [2.5, 3, 1, 1])[None, :3]
    mean = (vectors[0, 1, 3, 2] + vectors[0, 1, 3, 3]) / 2
    assert fields(between, Breath(0.0))[0] == pytest.approx(mean)
    with pytest.raises(InputError, match="folds"):
        require_smooth(PhaseFields(vectors * 40, grid.affine), STATES, BOUNDS, "phases.nii")


def test_a_gate_takes_the_views_of_its_phases():
    breaths = [Breath(phase) for phase in (0.0, 0.3, 0.6, 0.95)]
    assert gated(breaths, (0.2, 0.7)) == [1, 2]
    assert gated(breaths, (0.9, 0.1)) == [0, 3]
