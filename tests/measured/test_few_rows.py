"""Panels of one row (fan beam) and of two rows, reconstructed without a grid of the user's own."""

from __future__ import annotations

import nibabel
import numpy as np
import pytest
import yaml
from ball_scan import MU, PITCH, SDD, SOD

from twinct.cli import run_command
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.geometry.region import region_of_interest

VIEWS, COLUMNS, RADIUS = 60, 48, 8.0
BALL = np.array([9.0, 4.0, 0.0])


def images(rows: int) -> np.ndarray:
    """Return line integrals of a ball in the plane of the source, (views, rows, columns)."""
    angle = np.radians(np.arange(VIEWS) * 360 / VIEWS)
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    right = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (VIEWS, 1))
    panel = Panel(rows, COLUMNS, PITCH, PITCH)
    geometry = ScanGeometry(SOD * out, (SOD - SDD) * out, right, up, panel)
    result = []
    for view in range(VIEWS):
        ray = geometry.pixel_centres(view) - geometry.source[view]
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        off = geometry.source[view] - BALL
        result.append(2 * np.sqrt(np.maximum((ray @ off) ** 2 - off @ off + RADIUS**2, 0)))
    return MU * np.array(result, np.float32)


@pytest.mark.parametrize(("rows", "voxels"), [(1, 3), (2, 2), (3, 3)])
@pytest.mark.parametrize("algorithm", ["fdk", "sart", "fast"])
def test_a_flat_fan_gives_its_plane(rows, voxels, algorithm, circle, stored, tmp_path):
    source, out = tmp_path / "scan.yaml", tmp_path / "out"
    told = {"images": stored(images(rows)), "geometry": circle | {"angles": {"step": 360 / VIEWS}}}
    source.write_text(yaml.safe_dump(told))
    assert run_command(["import", str(source), "--out", str(out)]) == 0
    assert (
        run_command(["reconstruct", str(out), "--set", f"reconstruction.algorithm={algorithm}"])
        == 0
    )
    volume = nibabel.load(out / "reconstructions" / algorithm / "volume.nii")
    values, affine = np.asarray(volume.dataobj), volume.affine
    assert values.shape == (COLUMNS, COLUMNS, voxels)
    middle = values[:, :, voxels // 2]
    places = np.stack(np.indices(middle.shape), axis=-1) @ affine[:2, :2].T + affine[:2, 3]
    away = np.linalg.norm(places - BALL[:2], axis=-1)
    assert middle[away < RADIUS - 3].mean() == pytest.approx(MU, rel=0.07)
    assert abs(middle[(away > RADIUS + 3) & (np.hypot(*places.T).T < 20)].mean()) < 0.05 * MU


@pytest.mark.parametrize(("rows", "height"), [(1, 1.0), (2, 2.0), (3, 2.0)])
def test_a_panel_of_few_rows_sees_what_lies_on_it(rows, height):
    """One and two rows see as far as they reach, more rows from pixel centre to pixel centre."""
    source, detector = np.array([[SOD, 0.0, 0.0]]), np.array([[SOD - SDD, 0.0, 0.0]])
    u, v = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    geometry = ScanGeometry(source, detector, u, v, Panel(rows, COLUMNS, PITCH, PITCH))
    seen = region_of_interest(geometry, VolumeGrid((2001, 1, 1), 0.01))[:, 0, 0]
    assert 0.01 * seen.sum() == pytest.approx(height * PITCH * SOD / SDD, abs=0.03)
