"""Signals to detect on their way into an image: their attenuation along the rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry
from twinct.specimen.signals import Inserts, integral_at

_FAR_SIGMAS = 6.0
"""Distance from a Gaussian beyond which it counts as nothing, in standard deviations."""


class Insertion:
    """Attenuation of inserted signals along the rays of a view."""

    def __init__(self, inserts: Inserts) -> None:
        """Take the signals over."""
        self._inserts = inserts
        signal = inserts.signal
        self._far_mm = (
            signal.radius_mm if signal.kind == "sphere" else _FAR_SIGMAS * signal.sigma_mm
        )

    def attenuation(self, view: ScanGeometry, samples: int = 1) -> NDArray[np.float32]:
        """Return the line integrals of the signals at the samples of a view's pixels.

        Args:
            view: exactly one view, in the specimen's frame.
            samples: samples along each pixel edge.

        Returns:
            (rows * samples, columns * samples); below 0 for a signal that attenuates less than its
            surroundings.
        """
        panel = view.panel.divided(samples)
        across = np.arange(panel.columns, dtype=np.float64) * panel.pitch_u
        up = np.arange(panel.rows, dtype=np.float64) * panel.pitch_v
        across, up = across - across.mean(), up - up.mean()
        out = np.zeros(panel.shape, dtype=np.float32)
        source = view.source[0]
        for centre in self._inserts.centres_mm:
            rows, columns = (
                _near(along, axis, view, centre, self._far_mm)
                for along, axis in ((up, view.v[0]), (across, view.u[0]))
            )
            rays = (
                view.detector[0]
                - source
                + across[columns][None, :, None] * view.u[0]
                + up[rows][:, None, None] * view.v[0]
            )
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            away = np.linalg.norm(np.cross(rays, centre - source), axis=-1)
            near = integral_at(self._inserts.signal, away)
            out[rows, columns] += self._inserts.mu_per_mm * np.where(away <= self._far_mm, near, 0)
        return out


def _near(along: Floats, axis: Floats, view: ScanGeometry, centre: Floats, far_mm: float) -> slice:
    """Return the samples along an axis of the panel that a ball may shadow, and some more."""
    source, normal = view.source[0], view.normal[0]
    depth, sdd = float((source - centre) @ normal), float(view.sdd[0])
    if depth <= far_mm:
        return slice(0, len(along))
    at, start = float((centre - source) @ axis), float((view.detector[0] - source) @ axis)
    # The shadow of the box about the ball, from its nearest and farthest plane.
    ends = [
        (at + side * far_mm) * sdd / (depth + plane * far_mm) - start
        for side in (-1, 1)
        for plane in (-1, 1)
    ]
    low, high = np.searchsorted(along, [min(ends), max(ends)])
    return slice(max(int(low) - 1, 0), int(high) + 1)
