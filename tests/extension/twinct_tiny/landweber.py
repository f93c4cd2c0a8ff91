"""Landweber's iteration, from a volume on disk."""

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem
from twinct.recon.volume import Volume


class Landweber(AlgorithmSettings):
    """Landweber's iteration, from a volume on disk."""

    algorithm: Literal["landweber"] = "landweber"
    path: Path = Field(description="Where to start: .npy, (z, y, x).")
    steps: int = Field(default=2, ge=1, description="Number of steps.")


def _solve(problem: Problem, settings: Landweber) -> Volume:
    A, p = problem.projector, problem.line_integrals
    x = np.load(settings.path)
    step = np.float32(1 / A.T(A(np.ones_like(x))).max())
    for _ in range(settings.steps):
        x = x + step * A.T(p - A(x))
    return Volume(x, A.grid)


LANDWEBER = Algorithm(Landweber, _solve, volumes=3, projections=2)
