"""Primary kerma against what tables and the inverse square say."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon.volume import Volume
from twinct.specimen.materials import material
from twinct.trajectory import panel_axes
from twinct.view_planning import primary_kerma

TOWARDS = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
GEOMETRY = ScanGeometry(
    300 * TOWARDS, -300 * TOWARDS, *panel_axes(TOWARDS), Panel(60, 80, 2.0, 2.0)
)
BEAM = {"energy_kev": 60.0, "photons_per_mm2": 1e6, "absorption_cm2_g": 0.0319}


def _volume(mu: float) -> Volume:
    """A slab of 40 mm across x, in the middle."""
    array = np.zeros((20, 20, 40), np.float32)
    array[:, :, 10:30] = mu
    return Volume(array, VolumeGrid(array.shape, 2.0))


@pytest.mark.parametrize(
    ("kev", "water", "bone"),
    [
        # J. H. Hubbell, S. M. Seltzer, NISTIR 5632, table 4: liquid water, cortical bone (ICRU 44).
        (30.0, 0.1557, 1.069),
        (60.0, 0.03190, 0.1400),
        (100.0, 0.02546, 0.04585),
    ],
)
def test_energy_absorption_is_that_of_the_tables(kev, water, bone) -> None:
    """Within 1.5 %: coherent scatter, fluorescence and binding are small."""
    assert material("water").absorption_cm2_g(kev) == pytest.approx(water, rel=0.015)
    assert material("bone").absorption_cm2_g(kev) == pytest.approx(bone, rel=0.02)


def test_free_air_gets_photons_times_energy_times_absorption() -> None:
    (kerma,) = primary_kerma(GEOMETRY[0], [[0.0, 0, 0]], _volume(0), **BEAM)
    fluence_cm2 = 1e6 * 100 / 0.3**2  # at 300 mm
    assert kerma == pytest.approx(fluence_cm2 * 60 * 1.602177e-16 * 0.0319 * 1000, rel=1e-6)


def test_the_side_towards_the_source_gets_more() -> None:
    point = [[30.0, 0, 0]]  # in front of the slab for a source on +x, behind it for one on -x
    near, far, _ = primary_kerma(GEOMETRY, point, _volume(0.02), **BEAM)
    # Samples half a voxel apart, linear between voxels: exact but where the slab begins.
    assert near / far == pytest.approx((330 / 270) ** 2 * np.exp(0.02 * 40), rel=1e-3)


def test_a_point_in_the_slab_is_behind_what_lies_before_it() -> None:
    free = primary_kerma(GEOMETRY, [[10.0, 0, 0]], _volume(0), **BEAM)
    behind = primary_kerma(GEOMETRY, [[10.0, 0, 0]], _volume(0.02), **BEAM)
    assert behind[:2] / free[:2] == pytest.approx(np.exp([-0.02 * 10, -0.02 * 30]), rel=1e-3)


def test_what_the_panel_does_not_see_is_not_in_the_beam() -> None:
    kerma = primary_kerma(GEOMETRY, [[0.0, 60, 0], [0.0, 0, 0]], _volume(0), **BEAM)
    one = primary_kerma(GEOMETRY, [[0.0, 0, 0]], _volume(0), **BEAM)
    assert kerma[:2] == pytest.approx(one[:2] / 2)
    assert kerma[2] > one[2]  # along y it sees both, one of them nearer
