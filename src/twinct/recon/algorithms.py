"""All algorithms by name, built in or from extensions."""

from __future__ import annotations

from functools import cache
from typing import Any

from twinct.core.extensions import Registry
from twinct.recon.algorithm import Algorithm
from twinct.recon.cgls import CGLS
from twinct.recon.fast import FAST
from twinct.recon.fdk import FDK
from twinct.recon.fista_tv import FISTA_TV
from twinct.recon.os_sart import OS_SART
from twinct.recon.prior_tv import PRIOR_TV
from twinct.recon.rtk import RTK_SART
from twinct.recon.sart import SART
from twinct.recon.sirt import SIRT

BUILT_IN: dict[str, Algorithm[Any]] = {
    algorithm.name: algorithm
    for algorithm in (SART, FAST, OS_SART, SIRT, CGLS, FDK, FISTA_TV, PRIOR_TV, RTK_SART)
}


@cache
def algorithms() -> Registry[Algorithm[Any]]:
    """Return the algorithms that a scenario can name; they are looked up once per process."""
    return Registry("twinct.algorithms", Algorithm, BUILT_IN)
