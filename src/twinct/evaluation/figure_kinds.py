"""All kinds of figures by name, built in or from extensions."""

from __future__ import annotations

from functools import cache
from typing import Any

from twinct.core.extensions import Registry
from twinct.evaluation.figure_kind import FigureKind
from twinct.evaluation.kinds.contrasts import CONTRASTS
from twinct.evaluation.kinds.mtf import MTF
from twinct.evaluation.kinds.nps import NPS
from twinct.evaluation.kinds.regions import HOUNSFIELD, REGIONS
from twinct.evaluation.kinds.streaks import STREAKS
from twinct.evaluation.kinds.tasks import TASKS

BUILT_IN: dict[str, FigureKind[Any]] = {
    kind.name: kind for kind in (REGIONS, CONTRASTS, MTF, NPS, TASKS, STREAKS, HOUNSFIELD)
}


@cache
def figure_kinds() -> Registry[FigureKind[Any]]:
    """Return the kinds that a scenario can request; they are looked up once per process."""
    return Registry("twinct.figures", FigureKind, BUILT_IN)
