"""Positions of the shadows of balls in one projection, to a hundredth of a pixel.

The position of a shadow is the projection of the ball's centre. It is not the middle of the
elliptic shadow, which lies further out (Clackdoyle and Mennessier, Phys. Med. Biol. 56 (2011)
7371). So the ball itself is moved, parallel to the panel, until its analytic shadow fits the image,
and no ellipse's middle needs a correction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.calibration.phantom import BallPhantom
from twinct.geometry import Floats, ScanGeometry

SAMPLES = 4
"""Rays per pixel and axis of the analytic shadow."""

RIM_PX = 3.0
"""Width of the rim around a shadow, from which its background is estimated."""

LEAST_TRANSMISSION = 1e-4
"""Lower limit of pixel values: the noise of darker ones is no smaller than one photon's."""

RIM = 0.1
"""Lower limit of half chords in slopes, relative to the radius."""

STEPS = 20
WHOLE_STEPS = 6
"""Maximum number of Gauss-Newton steps, and the number of full steps among them.

Later steps are halved, as rays that cross the rim back and forth make full steps oscillate.
"""

STILL_PX = 1e-4
STILL_SHARE = 0.1
"""A shadow has settled if its step is below either, in pixels or in standard deviations."""

NEAR_PX = 0.3
"""Maximum distance of a well-measured shadow from the middle of its window."""

LEAST_RESPONSE = 0.35
"""Minimum response of a ball's spot, relative to the image's strongest spot."""


@dataclass(frozen=True, eq=False)
class Shadows:
    """Projections of balls' centres.

    Attributes:
        balls: indices of the balls, (n,).
        pixels: (column, row) of the projected centre, (n, 2).
        covariance: covariance of each, from the noise of its pixels, (n, 2, 2), px^2.
    """

    balls: NDArray[np.intp]
    pixels: Floats
    covariance: Floats

    def __len__(self) -> int:
        """Return the number of shadows."""
        return len(self.balls)

    def __getitem__(self, some: NDArray[np.bool_]) -> Shadows:
        """Return the shadows that a mask selects."""
        return Shadows(self.balls[some], self.pixels[some], self.covariance[some])


def spots(transmission: NDArray[np.float32], radius_px: float) -> Floats:
    """Detect blobs of a ball's size, to about a pixel, on any background.

    Args:
        transmission: one image, (rows, columns).
        radius_px: radius of a ball's shadow.

    Returns:
        (column, row) of each, (n, 2).
    """
    dark = -np.log(np.maximum(transmission, LEAST_TRANSMISSION))
    # The Laplacian of a Gaussian responds most to a disc of sqrt(2) sigma (Lindeberg 1998).
    response = -scipy.ndimage.gaussian_laplace(dark.astype(np.float64), radius_px / np.sqrt(2))
    highest = scipy.ndimage.maximum_filter(response, size=2 * int(np.ceil(radius_px)) + 1)
    peaks = (response == highest) & (response > LEAST_RESPONSE * response.max())
    return np.argwhere(peaks)[:, ::-1].astype(np.float64)


def shadow_radius_px(view: ScanGeometry, phantom: BallPhantom) -> Floats:
    """Return the approximate radius of each ball's shadow, (balls,), px."""
    depth = (view.source - phantom.centres) @ view.normal[0]
    return phantom.radius_mm * view.sdd[0] / depth / view.panel.pitch_u


def overlapping(pixels: Floats, radius_px: Floats, rim_px: float = RIM_PX) -> NDArray[np.bool_]:
    """Return a mask of shadows that another shadow touches, rims included, (n,).

    Args:
        pixels: projected centres, (n, 2); NaN if missing.
        radius_px: radii of the shadows, (n,).
        rim_px: width of the rim.
    """
    seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))
    touched = np.zeros(len(pixels), bool)
    reach = 2 * radius_px.max() + rim_px
    pairs = scipy.spatial.cKDTree(pixels[seen]).query_pairs(reach, output_type="ndarray")
    touched[seen[pairs.ravel()]] = True
    return touched


def measured(
    transmission: NDArray[np.float32],
    view: ScanGeometry,
    phantom: BallPhantom,
    balls: NDArray[np.intp],
    pixels: Floats,
    blur_px: float = 0.0,
    *,
    degree: int = 1,
    rim_px: float = RIM_PX,
) -> Shadows:
    """Fit the analytic shadow of each ball to the image around it.

    Args:
        transmission: one image, (rows, columns).
        view: approximate geometry: it determines the shadow's shape, not its place.
        phantom: the balls.
        balls: indices of the balls to measure, (n,).
        pixels: approximate places, to a pixel or two, (n, 2).
        blur_px: sigma of the detector's blur.
        degree: degree of the polynomial for the background's logarithm: 1 over air, 3 over bone,
            whose odd part would move a shadow.
        rim_px: width of the rim around a shadow that the fit includes.

    Returns:
        Measured shadows, without those that extend beyond the image or do not settle.
    """

    def shape(ball: int) -> _Shape:
        return _Shape(view, phantom.centres[ball], phantom.radius_mm, blur_px)

    shadows = [
        (ball, fit)
        for ball, start in zip(balls, pixels, strict=True)
        if (fit := _fitted(transmission, shape(ball), start, degree, rim_px)) is not None
    ]
    return Shadows(
        np.array([ball for ball, _ in shadows], np.intp),
        np.array([pixel for _, (pixel, _) in shadows]).reshape(-1, 2),
        np.array([spread for _, (_, spread) in shadows]).reshape(-1, 2, 2),
    )


def _fitted(
    transmission: NDArray[np.float32], shape: _Shape, start: Floats, degree: int, rim_px: float
) -> tuple[Floats, Floats] | None:
    """Return one shadow's pixel and its covariance; None if the fit fails."""
    reach = shape.reach_px + rim_px
    fit = None
    # The window stays fixed during a fit; one that follows the shadow would jump at the last steps.
    for _ in range(2):
        low = np.floor(start - reach).astype(int)
        high = np.ceil(start + reach).astype(int) + 1
        rows, columns = transmission.shape
        if (low < 0).any() or high[0] > columns or high[1] > rows:
            return None
        window = transmission[low[1] : high[1], low[0] : high[0]]
        fit = _settled(shape, window, low, start, reach, degree)
        if fit is None:
            return None
        near = np.abs(fit[0] - start).max() < NEAR_PX
        start = fit[0]
        if near:
            break
    return fit


def _settled(
    shape: _Shape,
    window: NDArray[np.float32],
    low: NDArray[np.intp],
    start: Floats,
    reach: float,
    degree: int,
) -> tuple[Floats, Floats] | None:
    """Fit place, attenuation and a background, a polynomial in its logarithm, by Gauss-Newton."""
    image = np.maximum(window, LEAST_TRANSMISSION).astype(np.float64)
    rows, columns = image.shape
    across, up = np.meshgrid(np.arange(columns) + low[0], np.arange(rows) + low[1])
    inside = np.hypot(across - start[0], up - start[1]) <= reach
    x, y = ((across - start[0])[inside] / reach, (up - start[1])[inside] / reach)
    terms = np.stack([x**i * y ** (n - i) for n in range(degree + 1) for i in range(n + 1)])
    place, mu = start.copy(), shape.first_mu(image)
    back = np.zeros(len(terms))
    back[0] = -np.log(np.quantile(image, 0.9))
    weight = 1 / np.sqrt(image[inside])
    for step in range(STEPS):
        chord_image, slopes, slope_mu = shape.transmission(place, mu, low, image.shape)
        behind = np.exp(-back @ terms)
        model = chord_image[inside] * behind
        jacobian = np.stack(
            [*(s[inside] * behind for s in slopes), slope_mu[inside] * behind, *(-model * terms)]
        )
        left = (image[inside] - model) * weight
        scaled = (jacobian * weight).T
        square = scaled.T @ scaled
        try:
            change = np.linalg.solve(square, scaled.T @ left)
        except np.linalg.LinAlgError:
            return None
        change *= 1.0 if step < WHOLE_STEPS else 0.5
        moved = change[:2] * min(1.0, 1.0 / max(np.abs(change[:2]).max(), 1e-12))
        place, mu, back = place + moved, max(mu + change[2], 1e-3), back + change[3:]
        if np.hypot(*(place - start)) > reach:
            return None
        if not step:
            continue
        freedom = max(inside.sum() - len(jacobian), 1)
        spread = np.linalg.inv(square)[:2, :2] * (left @ left) / freedom
        if np.abs(moved).max() < max(STILL_PX, STILL_SHARE * np.sqrt(spread.trace() / 2)):
            return place, spread
    return None


class _Shape:
    """Analytic shadow of a ball that moves parallel to the panel."""

    def __init__(
        self, view: ScanGeometry, centre: Floats, radius_mm: float, blur_px: float
    ) -> None:
        self._blur_px = blur_px
        panel = view.panel
        self._pitch = np.array([panel.pitch_u, panel.pitch_v])
        self._middle = np.array(panel.middle)
        self._sdd = float(view.sdd[0])
        # The origin is the source; the axes are the panel's.
        self._foot = view.piercing_points[0]
        self._depth = float(view.depth(centre)[0])
        self._radius = radius_mm
        widest = radius_mm * self._sdd / (self._depth - radius_mm) / self._pitch.min()
        obliqueness = self._obliqueness(view.project(centre)[0, 0])
        self.reach_px = float(widest * obliqueness + 3 * blur_px)

    def _obliqueness(self, pixel: Floats) -> float:
        """Return the shadow's length-to-width ratio at a pixel: 1 / cosine of the beam's angle."""
        off = (pixel - self._foot) * self._pitch
        return float(np.sqrt(1 + off @ off / self._sdd**2))

    def first_mu(self, image: Floats) -> float:
        """Estimate the initial attenuation, 1/mm, from the darkest and the brightest pixels."""
        return float(np.log(np.quantile(image, 0.9) / image.min()) / (2 * self._radius)) + 1e-3

    def transmission(
        self, pixel: Floats, mu: float, low: NDArray[np.intp], shape: tuple[int, ...]
    ) -> tuple[Floats, list[Floats], Floats]:
        """Return transmission, and its slopes by pixel and mu, for a centre projected to a pixel.

        Returns:
            Transmission, (rows, columns); two slopes, (rows, columns), 1/px; slope by mu, (rows,
            columns), mm.
        """
        rows, columns = shape
        margin = int(np.ceil(3 * self._blur_px)) if self._blur_px else 0
        fine = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
        c = (np.arange(-margin, columns + margin)[:, None] + fine).ravel() + low[0]
        r = (np.arange(-margin, rows + margin)[:, None] + fine).ravel() + low[1]
        x = ((c - self._foot[0]) * self._pitch[0])[None, :]
        y = ((r - self._foot[1]) * self._pitch[1])[:, None]
        centre = (pixel - self._foot) * self._pitch * self._depth / self._sdd
        # Squared half chord of the ray (x, y, sdd) from the source through the sphere.
        square = x * x + y * y + self._sdd**2
        along = centre[0] * x + centre[1] * y + self._depth * self._sdd
        beside = centre @ centre + self._depth**2 - self._radius**2
        half2 = along * along / square - beside
        half = np.sqrt(np.maximum(half2, 0.0))
        light = np.exp(-2 * mu * half)
        # The half chord's slope is unbounded at the rim, but its mean over a pixel is not.
        common = np.where(half2 > 0, -mu * light / np.maximum(half, RIM * self._radius), 0.0)
        per_mm = [
            common * (2 * along * axis / square - 2 * value)
            for axis, value in ((x, centre[0]), (y, centre[1]))
        ]
        per_px = [s * p * self._depth / self._sdd for s, p in zip(per_mm, self._pitch, strict=True)]
        images = [self._seen(a, margin) for a in (light, *per_px, -2 * half * light)]
        return images[0], images[1:3], images[3]

    def _seen(self, fine: Floats, margin: int) -> Floats:
        """Return the means of pixels, blurred."""
        rows, columns = fine.shape[0] // SAMPLES, fine.shape[1] // SAMPLES
        coarse = fine.reshape(rows, SAMPLES, columns, SAMPLES).mean(axis=(1, 3))
        if not margin:
            return coarse
        coarse = scipy.ndimage.gaussian_filter(coarse, self._blur_px, mode="nearest", truncate=3.0)
        return coarse[margin:-margin, margin:-margin]
