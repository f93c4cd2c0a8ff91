"""TIGRE's published geometry, written down again, has source, panel and voxels where twinct has.

TIGRE itself needs CUDA. Both halves of its definition are here: ``forward`` after
``computeDeltas_Siddon`` and the kernel of Common/CUDA/Siddon_projection.cu, ``backward`` after
``computeDeltasCube`` and the kernel of Common/CUDA/voxel_backprojection.cu (CERN/TIGRE; which entry
of an array goes where: ``convert_to_c_geometry`` of its Python side).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import cos, sin

from twinct.core.errors import InputError
from twinct.exchange.tigre import TIGRE, tigre_arrays
from twinct.geometry import Panel, ScanGeometry, VolumeGrid

EXACT_MM = 1e-9
"""Float64; measured 7e-13."""
SINGLE_PX = 5e-4
"""TIGRE rounds what it gets to float32: some 1e-7 of 600 mm and of pi; measured 2e-5."""


def rig_rotation(alpha: float, theta: float, psi: float) -> np.ndarray:
    """``eulerZYZ``, entry by entry."""
    return np.array(
        [
            [
                cos(alpha) * cos(theta) * cos(psi) - sin(alpha) * sin(psi),
                -cos(alpha) * cos(theta) * sin(psi) - sin(alpha) * cos(psi),
                cos(alpha) * sin(theta),
            ],
            [
                sin(alpha) * cos(theta) * cos(psi) + cos(alpha) * sin(psi),
                -sin(alpha) * cos(theta) * sin(psi) + cos(alpha) * cos(psi),
                sin(alpha) * sin(theta),
            ],
            [-sin(theta) * cos(psi), sin(theta) * sin(psi), cos(theta)],
        ]
    )


def panel_rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """``rollPitchYaw``, entry by entry."""
    return np.array(
        [
            [
                cos(roll) * cos(pitch),
                cos(roll) * sin(pitch) * sin(yaw) - sin(roll) * cos(yaw),
                cos(roll) * sin(pitch) * cos(yaw) + sin(roll) * sin(yaw),
            ],
            [
                sin(roll) * cos(pitch),
                sin(roll) * sin(pitch) * sin(yaw) + cos(roll) * cos(yaw),
                sin(roll) * sin(pitch) * cos(yaw) - cos(roll) * sin(yaw),
            ],
            [-sin(pitch), cos(pitch) * sin(yaw), cos(pitch) * cos(yaw)],
        ]
    )


def view_of(words: dict, view: int) -> dict:
    """The C side's names for one view, from the order of the Python side."""
    yaw, pitch, roll = words["rotDetector"][view]
    return {
        "rig": rig_rotation(*words["angles"][view]),
        "panel": panel_rotation(roll, pitch, yaw),
        "DSO": words["DSO"][view],
        "DSD": words["DSD"][view],
        "offOrig": words["offOrigin"][view][::-1],
        "offDetec": words["offDetector"][view][::-1],
        "nDetec": words["nDetector"][::-1],
        "dDetec": words["dDetector"][::-1],
    }


def forward(words: dict, view: int, u: int, v: int) -> tuple[np.ndarray, np.ndarray]:
    """Source, and centre of the pixel stored at row v, column u, from the volume's centre, mm."""
    w = view_of(words, view)
    (columns, rows), (width, height) = w["nDetec"], w["dDetec"]
    pixel_u, pixel_v = u, rows - v - 1
    along_u = width * (pixel_u - columns / 2 + 0.5)
    along_v = height * (rows / 2 - 0.5 - pixel_v)
    pixel = np.array([0.0, along_u, along_v])
    pixel = w["panel"] @ pixel + (-(w["DSD"] - w["DSO"]), *w["offDetec"])
    source = np.array([w["DSO"], 0.0, 0.0])
    return w["rig"] @ source - w["offOrig"], w["rig"] @ pixel - w["offOrig"]


def backward(words: dict, view: int, points: np.ndarray) -> np.ndarray:
    """(column, row) at which the back projection reads for points from the volume's centre."""
    w = view_of(words, view)
    shift = np.array([w["DSD"] - w["DSO"], 0.0, 0.0])
    offset = np.array([0.0, *w["offDetec"]])
    scale = np.array([1.0, *w["dDetec"]])
    seen = (points + w["offOrig"]) @ w["rig"] - offset
    seen = ((seen + shift) @ w["panel"] - shift) / scale
    source = ((np.array([w["DSD"], 0.0, 0.0]) - offset) @ w["panel"] - shift) / scale
    along = seen - source
    reach = (w["DSO"] - w["DSD"] - source[0]) / along[:, :1]
    # A texture is read at u + n/2, where pixel 0 has its centre at 0.5.
    return (along * reach + source)[:, 1:] + w["nDetec"] * 0.5 - 0.5


def test_every_view_is_where_it_was(free_views, grid) -> None:
    local = grid.world_from_grid.inverse() @ free_views
    words = tigre_arrays(local, grid)
    rows, columns = local.panel.shape
    for view in range(len(local)):
        centres = local.pixel_centres(view)
        for row, column in (
            (0, 0),
            (0, columns - 1),
            (rows - 1, 0),
            (rows - 1, columns - 1),
            (7, 20),
        ):
            source, pixel = forward(words, view, column, row)
            np.testing.assert_allclose(source, local.source[view], rtol=0, atol=EXACT_MM)
            np.testing.assert_allclose(pixel, centres[row, column], rtol=0, atol=EXACT_MM)


def test_back_projection_reads_where_points_project(free_views, grid, points) -> None:
    local = grid.world_from_grid.inverse() @ free_views
    words = tigre_arrays(local, grid)
    asked = local.project(points)
    single = {name: values.astype(np.float32) for name, values in words.items()}
    for view in range(len(local)):
        np.testing.assert_allclose(backward(words, view, points), asked[view], rtol=0, atol=1e-9)
        rounded = backward(single, view, points)
        np.testing.assert_allclose(rounded, asked[view], rtol=0, atol=SINGLE_PX)


def test_plain_views_get_plain_numbers(grid) -> None:
    """Source and panel face each other on a sphere, panel upright: nothing is offset or turned."""
    azimuth, elevation = np.radians(100.0), np.radians(-20.0)
    n = np.array([cos(azimuth) * cos(elevation), sin(azimuth) * cos(elevation), sin(elevation)])
    u = np.array([-sin(azimuth), cos(azimuth), 0.0])
    panel = Panel(4, 6, 1.0, 1.0)
    view = ScanGeometry(300 * n[None], -250 * n[None], u[None], np.cross(n, u)[None], panel)
    words = tigre_arrays(view, grid)
    np.testing.assert_allclose(words["angles"], [[azimuth, -elevation, 0]], atol=1e-12)
    np.testing.assert_allclose((words["DSO"][0], words["DSD"][0]), (300, 550))
    for name in ("offOrigin", "offDetector", "rotDetector"):
        np.testing.assert_allclose(words[name], 0, atol=1e-10)


def test_a_source_at_the_centre_is_refused_by_name(bundle) -> None:
    panel = Panel(4, 6, 1.0, 1.0)
    x, y, z = np.eye(3)
    views = ScanGeometry([300 * x, 0 * x], [-300 * x, -300 * x], [y, y], [z, z], panel)
    with pytest.raises(InputError, match="view 1 has its source 0 mm from the centre"):
        TIGRE.check(replace(bundle, geometry=views, grid=VolumeGrid((4, 4, 4), (2.0, 2.0, 2.0))))
