"""Focal spots: their moments, and the edge that they blur."""

import numpy as np
import pytest
from posed import posed
from xray_scenes import box

from twinct.core.errors import InputError
from twinct.geometry import Pose, ScanGeometry
from twinct.scenario import Detector, GaussianSpot, Source
from twinct.specimen import BuiltPart, BuiltSpecimen
from twinct.specimen.materials import material
from twinct.xray import Imager
from twinct.xray.spot import gaussian_spot, image_spot, square_spot, unit_square


@pytest.mark.parametrize("samples", [7, 24, 100])
def test_points_have_the_variance_of_the_spot(samples):
    for points, variance in (
        (gaussian_spot(0.3, 0.1, unit_square(samples)), (0.09, 0.01)),
        (square_spot(0.6, 0.4, unit_square(samples)), (0.03, 0.16 / 12)),
    ):
        assert points.shape == (samples, 2)
        np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)
        np.testing.assert_allclose(points.var(axis=0), variance)
        assert len(np.unique(points.round(9)[:, 0])) == samples


def test_points_of_an_image_lie_where_it_is_bright():
    picture = np.zeros((20, 30))
    picture[15:18, 3:9] = 2.0
    picture[2, 25] = 12.0
    points = image_spot(picture, 3.0, 2.0, unit_square(400))
    x, y = (points / [3.0, 2.0] + 0.5).T * [[30], [20]]
    left = (x >= 3) & (x < 9) & (y >= 15) & (y < 18)
    right = (x >= 25) & (x < 26) & (y >= 2) & (y < 3)
    assert (left | right).all()
    assert left.mean() == pytest.approx(36 / 48, abs=0.02)
    with pytest.raises(InputError, match="intensity"):
        image_spot(np.zeros((3, 3)), 1, 1, unit_square(4))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_gaussian_spot_blurs_an_edge_by_its_size_times_the_magnification(axis):
    """An opaque half-plane half-way: the edge spreads by sigma (m - 1), and the pixel's width."""
    sigma, pitch, samples = (0.4, 0.2), 0.1, 64
    detector = Detector(columns=120, rows=120, pixel_pitch_mm=pitch, pixel_samples=2)
    view = ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], detector.panel)
    size = np.array([0.01, 100.0, 100.0])
    centre = np.zeros(3)
    centre[axis + 1] = -50.0
    plate = BuiltPart("plate", material("Au"), box(centre, size))
    spot = GaussianSpot(kind="gaussian", sigma_mm=sigma, samples=samples)
    source = Source(energy_kev=10, focal_spot=spot)
    with Imager(source, detector, BuiltSpecimen((plate,), Pose.identity())) as imager:
        image = imager.render(view, Pose.identity())
    edge = image.mean(axis=axis) / image.max()
    line = np.diff(edge)
    x = np.arange(len(line)) * pitch
    width = np.sqrt(line @ x**2 / line.sum() - (line @ x / line.sum()) ** 2)
    # Sampling steps and the difference of two pixels: two boxes of a pixel.
    expected = np.sqrt(sigma[axis] ** 2 + 2 * pitch**2 / 12)
    assert width == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("samples", [1, 2])
@pytest.mark.parametrize("flat_geometry", ["commanded", "first", "view"])
def test_the_free_beam_of_a_spot_off_its_centre_is_one(tmp_path, flat_geometry, samples):
    """The flat image is taken with the same spot; without, this beam is off by 0.7 %."""
    picture = np.zeros((8, 8))
    picture[0:2, 5:8] = 1
    np.save(tmp_path / "spot.npy", picture)
    spot = {"kind": "image", "path": tmp_path / "spot.npy", "size_mm": 12.0, "samples": 6}
    detector = Detector(
        columns=40,
        rows=30,
        pixel_pitch_mm=8.0,
        pixel_samples=samples,
        readout={"bits": None, "free_beam": 1000, "offset": 0},
        correction={"flat_geometry": flat_geometry},
    )
    view = ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], detector.panel)
    far = BuiltPart("ball", material("bone"), box((0, 70, 0), (5, 5, 5)))
    specimen = BuiltSpecimen((far,), Pose.identity())
    with Imager(Source(focal_spot=spot), detector, specimen, commanded=view) as imager:
        frame = imager.frame(posed(view))
    free = np.s_[:, :25]
    np.testing.assert_allclose(frame.transmission[free], 1, atol=2e-6)
    # The gain is set with the same spot.
    assert frame.flat[14:16, 19:21].mean() == pytest.approx(1000, rel=2e-4)
