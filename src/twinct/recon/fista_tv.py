"""The objective of ``fast``, much closer to its minimum.

It takes several times as long. Volumes whose differences matter more than time, such as those of a
study of views or photons, then owe less to how far the passes came.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from twinct.recon.fast import FAST, Penalised
from twinct.recon.shared_keys import Passes, Tolerance

PASSES, TOLERANCE = 100, 0.002
"""Most passes at full resolution, and the change of the volume in the last one."""


class FistaTv(Penalised):
    """The objective of ``fast``, much closer to its minimum, in several times the time."""

    algorithm: Literal["fista_tv"] = "fista_tv"
    passes: Passes = PASSES
    tolerance: Tolerance = TOLERANCE


FISTA_TV = replace(FAST, settings=FistaTv)
