"""Cross-sections: the right plane, the right way up, at the right place."""

import numpy as np
import pytest

from twinct.geometry import Pose, VolumeGrid
from twinct.report import cross_sections


def test_planes_axes_and_extents():
    grid = VolumeGrid((4, 6, 8), (1.0, 2.0, 3.0), Pose([100, 200, 300], [0, 0, 0, 1]))
    k, j, i = np.indices(grid.shape)
    volume = 100 * k + 10 * j + i
    sections = cross_sections(volume, np.ones(grid.shape), k + j > 3, grid)
    axial, coronal, sagittal = (sections[name] for name in ("axial", "coronal", "sagittal"))

    assert np.array_equal(axial.reconstruction, 200 + 10 * j[0] + i[0]), "k = 2, rows y, columns x"
    assert np.array_equal(coronal.reconstruction, (100 * k + 30 + i)[:, 0]), "j = 3, rows z"
    assert np.array_equal(sagittal.reconstruction, (100 * k + 10 * j + 4)[:, :, 0]), "i = 4, rows z"
    assert np.array_equal(axial.roi, j[0] > 1)
    # Outer edges about the middle: 8 x 1, 6 x 2, 4 x 3 mm.
    assert axial.extent_mm == (96, 104, 194, 206)
    assert coronal.extent_mm == (96, 104, 294, 306)
    assert sagittal.extent_mm == (194, 206, 294, 306)
    assert [s.axes for s in sections.values()] == [("x", "y"), ("x", "z"), ("y", "z")]
    assert [s.position for s in sections.values()] == [
        "z = 301.5 mm",
        "y = 201.0 mm",
        "x = 100.5 mm",
    ]


def test_a_plane_that_misses_the_specimen_moves_to_it():
    grid = VolumeGrid((20, 20, 20), 1.0)
    truth = np.zeros(grid.shape)
    truth[2:7, 8:13, 15:18] = 1
    sections = cross_sections(truth, truth, truth > 0, grid)
    assert sections["axial"].position == "z = -5.5 mm"
    assert sections["coronal"].position == "y = 0.5 mm", "the middle plane meets it"
    assert sections["sagittal"].position == "x = 6.5 mm"
    assert all(section.truth.any() for section in sections.values())


def test_turned_grid_keeps_its_own_coordinates():
    grid = VolumeGrid((2, 2, 2), 1.0, Pose.from_euler((9, 9, 9), (0, 0, 30)))
    ones = np.ones(grid.shape)
    axial = cross_sections(ones, ones, ones > 0, grid)["axial"]
    assert axial.axes == ("grid x", "grid y")
    assert axial.extent_mm == pytest.approx((-1, 1, -1, 1))
