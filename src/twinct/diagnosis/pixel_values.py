"""Wrong values of pixels, at right poses: level of the air, beam, metal, ends of the range."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.diagnosis.cause import Cause
from twinct.diagnosis.coarse import Coarse
from twinct.recon.engine import Singles

DARK = 8.0
"""Line integral from which scatter is not told from starved pixels."""


def _air(scan: Coarse) -> Iterator[Singles]:
    """Yield a constant, and its course over the scan."""
    level = np.ones(scan.p.shape, np.float32)
    time = np.linspace(-1, 1, len(level), dtype=np.float32)[:, None, None]
    yield from (level, level * time, level * time**2)


def _beam(scan: Coarse) -> Iterator[Singles]:
    """Yield what a beam that hardens lacks, and what scattered photons lack beside the object."""
    q = np.maximum(scan.predicted - scan.metal, 0)
    yield q**2
    yield np.asarray(np.exp(np.minimum(q, DARK)) - 1 - q, np.float32)


def _metal(scan: Coarse) -> Iterator[Singles]:
    """Yield wrong attenuation of metal, and hardening by metal alone and with the rest."""
    if scan.metal.any():
        metal = scan.metal
        yield from (metal, metal * metal, metal * (scan.predicted - metal))


def _ends(scan: Coarse) -> Iterator[Singles]:
    """Yield the pixels at an end of the range, and their line integrals."""
    for at_end in (scan.lowest, scan.highest):
        if at_end.any():
            yield from (at_end, at_end * scan.predicted)


AIR = Cause("air", _air)
"""Flats or free beam of another exposure, or a tube that drifts."""

BEAM = Cause("beam", _beam)
"""Beam hardening or scatter, which a scan alone does not tell apart."""

METAL = Cause("metal", _metal)

PIXELS = Cause("pixels", _ends)
"""Starved or saturated pixels."""
