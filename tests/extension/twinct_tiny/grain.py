"""Noise of the volume itself in a region, which needs no truth."""

import numpy as np
from pydantic import Field

from twinct.evaluation import Figure, FigureKind, FigureSettings, Measurement


class Grain(FigureSettings):
    """Noise from voxel to voxel in a region."""

    region: str = Field(description="Name of the region.")


def _measure(at: Measurement, one: Grain) -> dict[str, float]:
    voxels = at.region(one.region)
    steps = np.diff(at.volume[voxels.box].astype(np.float64), axis=0)
    return {"grain_per_mm": float(np.median(np.abs(steps)))} if steps.size else {}


GRAIN = FigureKind(
    "grain",
    Grain,
    "Regions in which the noise of the volume itself is measured.",
    (Figure("grain_per_mm", "grain", "1/mm", 1, 5, "of the volume", good="low"),),
    _measure,
    names={"region": "region"},
    needs_truth=False,
)
