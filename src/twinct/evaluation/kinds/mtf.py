"""Local modulation transfer, at the edge of a sphere or at the side of a cylinder."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.evaluation.figure import Figure
from twinct.evaluation.figure_kind import (
    Curve,
    FigureKind,
    FigureSettings,
    Measurement,
    NamedPlaces,
)
from twinct.evaluation.mtf import Mtf, edge_mtf, edge_reach
from twinct.evaluation.region_voxels import ball, centres, cylinder

log = logging.getLogger(__name__)

_LEAST_RADIUS_VOXELS = 2.0
"""Smallest radius of a body whose edge gives an MTF, voxels."""


_FALLS = "frequency at which the transfer is a "
_CAPTION = "Modulation transfer, measured at the edge of the named body."


class Transfer(FigureSettings):
    """Local modulation transfer, measured at the edge of a sphere or at the side of a cylinder."""

    at: str = Field(
        description="Name of a part or region that is a sphere or a cylinder; the surface of a "
        "region must be that of a body of the specimen."
    )


def transfer_at(at: Measurement, name: str) -> Mtf | None:
    """Return the MTF at a round body; None, with a warning, if it has none."""
    pose, radius, height = at.places.body(name)
    voxel = float(at.grid.voxel.min())
    reach = edge_reach(radius, voxel)
    if height is None:
        box, curved = ball(at.grid, pose, radius + reach).box, 2
    else:
        box, curved = cylinder(at.grid, pose, radius + reach, height).box, 1
    points = centres(at.grid, box, pose)
    offset = np.linalg.norm(points[..., : curved + 1], axis=-1) - radius
    values = at.volume[box]
    if height is not None:  # the lateral surface only
        side = np.abs(points[..., 2]) <= height / 2
        offset, values = offset[side], values[side]
    try:
        return edge_mtf(values, offset, radius, voxel, curved)
    except InputError as error:
        log.warning("no MTF at %s: %s", name, error)
        return None


def _measure(at: Measurement, one: Transfer) -> dict[str, Any]:
    transfer = at.once(transfer_at, one.at)
    if transfer is None:
        return {}
    return {
        "f50_per_mm": transfer.falls_to(0.5),
        "f10_per_mm": transfer.falls_to(0.1),
        "frequency_per_mm": transfer.frequency_per_mm,
        "mtf": transfer.value,
    }


def _check(places: NamedPlaces, one: Transfer) -> dict[str, str]:
    pose, radius, _ = places.body(one.at)
    least, found = _LEAST_RADIUS_VOXELS * float(places.grid.voxel.max()), ""
    if radius < least:
        found = (
            f"has a radius of {radius:g} mm; its edge needs at least {least:g} mm, "
            f"{_LEAST_RADIUS_VOXELS:g} voxels"
        )
    elif not len(ball(places.grid, pose, radius)):
        found = "lies outside the grid"
    return {"at": f"{quoted(one.at)} {found}"} if found else {}


MTF = FigureKind(
    "mtf",
    Transfer,
    "Parts and regions at which the modulation transfer is measured.",
    (
        Figure("f50_per_mm", "MTF 50 %", "mm⁻¹", meaning=_FALLS + "half", best="higher"),
        Figure("f10_per_mm", "MTF 10 %", "mm⁻¹", meaning=_FALLS + "tenth", best="higher"),
    ),
    _measure,
    names={"at": "round body"},
    check=_check,
    curves=(Curve("mtf", "MTF", "Modulation transfer", _CAPTION),),
)
