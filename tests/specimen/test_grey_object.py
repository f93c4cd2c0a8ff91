"""A reconstructed volume as a specimen: right at its energy, and through a whole spectrum."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import SpecimenError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.scenario import Detector, Source
from twinct.specimen.grey_object import grey_specimen
from twinct.specimen.materials import material
from twinct.xray import Imager

MU, KEV = 0.05, 40.0
WATER = material("water")
GRID = VolumeGrid((12, 12, 12), 1.0, Pose.from_euler([0, 0, 0], [0, 0, 90]))
VIEW = ScanGeometry(
    np.array([[500.0, 0, 0]]),
    np.array([[-500.0, 0, 0]]),
    np.array([[0, 1.0, 0]]),
    np.array([[0, 0, 1.0]]),
    Panel(3, 3, 0.01, 0.01),
)


def transmission(values: np.ndarray, source: Source) -> float:
    """Transmission along the x axis, through the middle of the grid."""
    specimen = grey_specimen(values, GRID, WATER, KEV, "volume")
    panel = {"columns": 3, "rows": 3, "pixel_pitch_mm": 0.01}
    with Imager(source, Detector(**panel), specimen, commanded=VIEW) as imager:
        return float(imager.render(VIEW, specimen.world_from_specimen)[1, 1])


def test_one_energy_and_a_spectrum_attenuate_as_the_material_says(tmp_path) -> None:
    values = np.zeros(GRID.shape, np.float32)
    values[:, 2:10, :] = MU  # along the grid's y, which is the world's x but for its sign
    # The linear field falls to 0 within half a voxel more on both sides, on average.
    length = 8.0
    one = transmission(values, Source(energy_kev=KEV))
    assert one == pytest.approx(np.exp(-MU * length), rel=1e-4)
    (tmp_path / "lines.txt").write_text("25 1\n60 1\n")
    two = transmission(values, Source(spectrum={"kind": "file", "path": tmp_path / "lines.txt"}))
    share = np.array([25.0, 60.0]) / 85.0  # an integrating detector weighs with the energy
    depth = MU * length * np.array([WATER.mu_per_mm(e) for e in (25, 60)]) / WATER.mu_per_mm(KEV)
    assert two == pytest.approx(float(share @ np.exp(-depth)), rel=1e-3)


def test_negative_voxels_stay_and_nothing_at_all_is_refused() -> None:
    values = np.zeros(GRID.shape, np.float32)
    with pytest.raises(SpecimenError, match="no voxel attenuates"):
        grey_specimen(values, GRID, WATER, KEV, "volume")
    values[5, 5, 5], values[5, 5, 7] = 0.02, -0.01
    field = grey_specimen(values, GRID, WATER, KEV, "volume").mixtures[0].field
    assert field.mu_per_mm(KEV).min() == pytest.approx(-0.01, rel=1e-5)
    assert field.mu_per_mm(KEV).max() == pytest.approx(0.02, rel=1e-5)
    assert np.argwhere(field.amounts[..., 0])[0].tolist() == [6, 6, 6]
