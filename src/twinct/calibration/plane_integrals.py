"""Derivatives of the specimen's integrals over planes through the source, from one projection.

A plane through the source cuts the panel in a line. Let H be the source's distance from the panel's
plane, L its distance from a point on the panel, and q the distance of the line from the foot of the
perpendicular. Integrate the projection along the line, each point weighted by H/L. The derivative
by the line's offset, times (H^2 + q^2)/H^2, is the derivative of the specimen's plane integral as
the plane shifts along its normal (Grangeat, in: Mathematical Methods in Tomography, LNM 1497, 1991,
66). It is equal for all sources on the plane.

For a plane with unit normal n, three numbers of the view suffice: n.u, n.v and n.(S - D). The first
two are the line's normal in the panel, h times a unit vector. The third is h times the line's
offset from the panel's centre; and 1/h^2 is the factor (H^2 + q^2)/H^2.

Instead of differentiating the integrals, the slopes of the weighted projection across the line are
integrated. Both agree if the panel covers the specimen along the line. If it does not, the
derivative would also see the panel's edge, and slopes come nearer to the complete integral.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry

BINS_PX = 2
"""Bins per pixel along the offset; a pixel is shared between two of them."""

SMOOTH_PX = 0.7
"""Sigma of the Gaussians for slopes and for offsets; it hides the sampling by pixels."""

PAD = 6
"""Directions added beyond a half turn on either side, so that no sample is near an end."""

THICK = 99.0
"""Percentile of all line integrals that represents the thickest rays."""

LOST_PX = 0.01
"""Maximum weight of invalid pixels on a valid line, in pixels."""

LEAST_CHORD = 0.25
"""Minimum length of a line, relative to the panel's shorter side; others only cut a corner."""

STEP = 0.05
"""Step of the spline's finite differences, in directions and offsets."""


class PlaneIntegrals:
    """Derivatives of plane integrals, for each view of a scan."""

    def __init__(
        self,
        line_integrals: NDArray[np.float32],
        geometry: ScanGeometry,
        mask: NDArray[np.bool_] | None = None,
    ) -> None:
        """Integrate each view along all lines.

        Args:
            line_integrals: (views, rows, columns).
            geometry: geometry of the views; only the source's place relative to the panel matters
                here.
            mask: True where a pixel counts, (views, rows, columns).
        """
        panel = geometry.panel
        self._pitches = panel.pitch_u, panel.pitch_v
        self._halves = -panel.first_pixel_mm[0], -panel.first_pixel_mm[1]
        blur = SMOOTH_PX * max(self._pitches)
        self._bin = min(self._pitches) / BINS_PX
        self._middle = int(np.ceil((float(np.hypot(*self._halves)) + 5 * blur) / self._bin))
        self._turn = np.pi / int(np.ceil(np.pi * np.hypot(panel.rows, panel.columns) / 2))
        along = (
            first + pitch * np.arange(n)
            for first, pitch, n in zip(
                panel.first_pixel_mm, self._pitches, panel.shape[::-1], strict=True
            )
        )
        a, b = cast(list[Floats], np.meshgrid(*along))
        if mask is not None:
            line_integrals = np.where(mask, line_integrals, np.float32(0))
        weighted = line_integrals * _cosines(geometry, a, b)
        # Differentiate each pixel, so that the panel's edge has no slope.
        sigmas = 0, blur / panel.pitch_v, blur / panel.pitch_u
        by_v, by_u = (
            scipy.ndimage.gaussian_filter(weighted, sigmas, order=order, mode="nearest") / pitch
            for order, pitch in (((0, 1, 0), panel.pitch_v), ((0, 0, 1), panel.pitch_u))
        )
        sums = self._summed(a, b, by_u, by_v) * (panel.pitch_u * panel.pitch_v / self._bin)
        scipy.ndimage.gaussian_filter1d(sums, blur / self._bin, axis=2, output=sums)
        self._splines = [
            scipy.ndimage.spline_filter(_padded(one, -1.0), order=3, output=np.float32)
            for one in sums
        ]
        # At the border, one pixel's noise must not decide, and anything that just reaches it must.
        smooth = scipy.ndimage.gaussian_filter(line_integrals, (0, 1, 1), mode="nearest")
        counted = line_integrals if mask is None else line_integrals[mask]
        thick = max(float(np.percentile(counted, THICK)), 1e-9)
        self._border = scipy.ndimage.maximum_filter(smooth, (1, 3, 3)) / thick
        self._lost = None
        if mask is not None and not mask.all():
            # A slope depends on the pixels around its own.
            lost = scipy.ndimage.maximum_filter((~mask).astype(np.float32), (1, 7, 7))
            self._lost = [_padded(one, 1.0) for one in self._summed(a, b, lost)]

    def _summed(self, a: Floats, b: Floats, *parts: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return sums along lines of all directions of a half turn, (views, directions, offsets).

        Args:
            a: position of each pixel along u, (rows, columns), mm from the panel's centre.
            b: position along v.
            parts: one image or two, (views, rows, columns); two are components along u and v, of
                which the one across the line is summed.
        """
        views, pixels = len(parts[0]), a.size
        flat = [np.ascontiguousarray(part.reshape(views, -1).T) for part in parts]
        directions = round(np.pi / self._turn)
        sums = np.empty((views, directions, 2 * self._middle + 1), np.float32)
        shape, ends = (sums.shape[2], pixels), np.arange(0, 2 * pixels + 1, 2)
        for index in range(directions):
            at = self._turn * index
            place = (a * np.cos(at) + b * np.sin(at)).ravel() / self._bin + self._middle
            below = place.astype(np.int32)
            share = (place - below).astype(np.float32)
            rows = np.stack([below, below + 1], axis=1).ravel()
            values = np.stack([1 - share, share], axis=1).ravel()
            spread: Any = scipy.sparse.csc_array((values, rows, ends), shape=shape)
            image = flat[0]
            if len(flat) == 2:
                image = np.float32(np.cos(at)) * image + np.float32(np.sin(at)) * flat[1]
            sums[:, index] = (spread @ image).T
        return sums

    def at(self, view: int, lines: Floats) -> tuple[Floats, Floats, Floats]:
        """Return derivatives of plane integrals from one view.

        Args:
            view: index of the view.
            lines: n.u, n.v and n.(S - D) of each plane's unit normal n, (..., 3).

        Returns:
            The derivatives, (...), their gradient by ``lines``, (..., 3), and the line integral at
            the ends of each line, the larger of both, relative to the thickest rays, (...). The
            last is infinite if a line misses the panel or contains a pixel that does not count.
        """
        shape = lines.shape[:-1]
        la, lb, lc = lines.reshape(-1, 3).T
        h = np.hypot(la, lb)
        with np.errstate(divide="ignore", invalid="ignore"):
            ca, cb, offset = la / h, lb / h, lc / h
        ends, whole = self._ends(ca, cb, offset)
        columns, rows = (
            np.rint((end + half) / pitch).astype(int).clip(0, int(round(2 * half / pitch)))
            for end, half, pitch in zip(ends, self._halves, self._pitches, strict=True)
        )
        left = self._border[view][rows, columns].max(axis=0)
        angle = np.arctan2(cb, ca)
        # Beyond the half turn, it is an equal line with its normal reversed.
        over = (angle < 0) | (angle >= np.pi)
        sign = np.where(over, -1.0, 1.0)
        at = np.nan_to_num(
            [
                (angle - np.where(over, np.copysign(np.pi, angle), 0.0)) / self._turn + PAD,
                np.where(whole, sign * offset, 0.0) / self._bin + self._middle,
            ]
        )
        if self._lost is not None:
            lost = scipy.ndimage.map_coordinates(self._lost[view], at, order=1)
            whole &= lost < LOST_PX
        steps = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]).T[:, :, None] * STEP
        value, later, before, outer, inner = scipy.ndimage.map_coordinates(
            self._splines[view],
            at[:, None] + steps,
            order=3,
            prefilter=False,
            output=np.float64,
        )
        value = sign * value
        by_turn = sign * (later - before) / (2 * STEP * self._turn)
        by_offset = (outer - inner) / (2 * STEP * self._bin)
        with np.errstate(divide="ignore", invalid="ignore"):
            ga = (-by_turn * cb - by_offset * offset * ca - 2 * value * ca) / h**3
            gb = (by_turn * ca - by_offset * offset * cb - 2 * value * cb) / h**3
            gc = by_offset / h**3
            second = value / h**2
        gradient = np.stack([ga, gb, gc], axis=-1)
        gradient[~whole], second[~whole] = 0, 0
        left[~whole] = np.inf
        return second.reshape(shape), gradient.reshape(*shape, 3), left.reshape(shape)

    def _ends(
        self, ca: Floats, cb: Floats, offset: Floats
    ) -> tuple[tuple[Floats, Floats], NDArray[np.bool_]]:
        """Return the ends of lines on the panel, u and v, each (2, lines), and a validity mask."""
        with np.errstate(divide="ignore", invalid="ignore"):
            # x = offset (ca, cb) + t (-cb, ca) lies within the panel for t between these.
            at = [
                np.sort([(sign * half - offset * near) / slope for sign in (-1, 1)], axis=0)
                for half, near, slope in zip(self._halves, (ca, cb), (-cb, ca), strict=True)
            ]
        low, high = np.fmax(at[0][0], at[1][0]), np.fmin(at[0][1], at[1][1])
        with np.errstate(invalid="ignore"):
            whole = high - low > LEAST_CHORD * 2 * min(self._halves)
        t = np.where(whole, [low, high], 0.0)
        place = np.where(whole, offset, 0.0)
        ca, cb = np.where(whole, ca, 0.0), np.where(whole, cb, 0.0)
        return (place * ca - t * cb, place * cb + t * ca), whole


def _cosines(geometry: ScanGeometry, a: Floats, b: Floats) -> NDArray[np.float32]:
    """Return H/L of each pixel, (views, rows, columns)."""
    over = geometry.source - geometry.detector
    foot_u, foot_v, height = (
        np.einsum("vk,vk->v", over, axis)[:, None, None]
        for axis in (geometry.u, geometry.v, geometry.normal)
    )
    lengths = np.sqrt((a - foot_u) ** 2 + (b - foot_v) ** 2 + height**2)
    return (height / lengths).astype(np.float32)


def _padded(half_turn: NDArray[np.float32], sign: float) -> NDArray[np.float32]:
    """Return directions extended beyond a half turn: equal lines with reversed normals."""
    turned = np.float32(sign) * half_turn[:, ::-1]
    return np.concatenate([turned[-PAD:], half_turn, turned[:PAD]])
