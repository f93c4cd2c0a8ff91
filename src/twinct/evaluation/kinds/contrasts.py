"""Contrast and contrast-to-noise ratio of one region against another."""

from __future__ import annotations

from pydantic import Field

from twinct.evaluation.contrast import contrast
from twinct.evaluation.figure import Figure, percent
from twinct.evaluation.figure_kind import FigureKind, FigureSettings, Measurement


class RegionContrast(FigureSettings):
    """Contrast and contrast-to-noise ratio of one region against another."""

    region: str = Field(description="Name of the region.")
    against: str = Field(description="Name of the background region.")

    @property
    def label(self) -> str:
        """Name of its figures."""
        return f"{self.region}_against_{self.against}"


_OVER_NOISE = "over the background's standard deviation"


def _measure(at: Measurement, one: RegionContrast) -> dict[str, float]:
    inner, outer = at.region(one.region), at.region(one.against)
    values, true = ((inner.of(array), outer.of(array)) for array in (at.volume, at.truth))
    return contrast(*values, *true, at.mu_reference).as_dict()


CONTRASTS = FigureKind(
    "contrasts",
    RegionContrast,
    "Contrasts between regions.",
    (
        percent(
            "contrast_rel",
            "contrast",
            "of μ({0}), difference of the means",
            good="the true contrast",
            without_signal="any",
        ),
        percent(
            "recovery",
            "contrast recovery",
            "of the true contrast",
            "one",
            1,
            good="95 to 105 %",
            without_signal="worse",
            blind_to=("noise",),
        ),
        Figure(
            "cnr",
            "contrast to noise",
            digits=2,
            meaning=_OVER_NOISE,
            best="higher",
            good="above 5",
            without_signal="null",
            blind_to=("smoothing",),
            beside=("recovery", "/edge_width_mm"),
        ),
    ),
    _measure,
    names={"region": "region", "against": "region"},
)
