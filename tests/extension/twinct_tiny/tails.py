"""Error in a region that few of its voxels exceed."""

import numpy as np
from pydantic import Field

from twinct.evaluation import Figure, FigureKind, FigureSettings, Measurement


class Tail(FigureSettings):
    """Error that a share of a region's voxels exceeds."""

    region: str = Field(description="Name of the region.")
    share: float = Field(default=0.01, gt=0, lt=1, description="Share of the voxels.")


def _measure(at: Measurement, one: Tail) -> dict[str, float]:
    voxels = at.region(one.region)
    if not len(voxels):
        return {}
    error = np.abs(voxels.of(at.volume) - voxels.of(at.truth))
    return {"tail_rel": float(np.quantile(error, 1 - one.share)) / at.mu_reference}


TAILS = FigureKind(
    "tails",
    Tail,
    "Regions whose largest errors are measured.",
    (
        Figure(
            *("tail_rel", "largest errors", "%", 100, 1, "of μ({0})"),
            best="lower",
            good="below 10 %",
            without_signal="null",
        ),
    ),
    _measure,
    names={"region": "region"},
)
