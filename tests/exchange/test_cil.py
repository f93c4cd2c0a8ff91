"""What CIL makes of its own arguments, after its convert_geometry_to_astra_vec_3D.

CIL itself comes from conda only. From those vectors on, test_astra holds.
"""

from __future__ import annotations

import runpy

import numpy as np

from twinct.exchange import write_bundle


def test_cil_hands_astra_the_vectors_that_we_do(bundle, tmp_path) -> None:
    write_bundle(tmp_path / "cil", "cil", bundle)
    images, words = runpy.run_path(str(tmp_path / "cil" / "load.py"))["arrays"]()
    np.testing.assert_array_equal(images, bundle.images)
    # Panel origin bottom-left: no axis changes its sign.
    along_x, along_y = words["pixel_size"]
    vectors = np.hstack(
        [
            words["source_position_set"],
            words["detector_position_set"],
            along_x * words["detector_direction_x_set"],
            along_y * words["detector_direction_y_set"],
        ]
    )
    np.testing.assert_array_equal(vectors, bundle.local.to_astra()["Vectors"])
    columns, rows = words["num_pixels"]
    assert (rows, columns) == bundle.geometry.panel.shape == images.shape[1:]


def test_cils_volume_is_ours(bundle, grid, tmp_path) -> None:
    """ImageGeometry takes counts and edges along x, y, z, and its arrays are (z, y, x)."""
    write_bundle(tmp_path / "cil", "cil", bundle)
    _, words = runpy.run_path(str(tmp_path / "cil" / "load.py"))["arrays"]()
    assert tuple(words["volume"][::-1]) == grid.shape
    np.testing.assert_array_equal(words["voxel"], grid.voxel)
