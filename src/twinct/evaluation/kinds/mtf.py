"""Local modulation transfer, at the edge of a sphere or at the side of a cylinder."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.evaluation.edge_place import SEARCH, edge_place
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
from twinct.geometry import Floats, Pose

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


class LocalTransfer(NamedTuple):
    """Modulation transfer at a body, and the distance of its edge from the true one.

    Attributes:
        mtf: the transfer.
        shift_mm: shift of the body's centre.
    """

    mtf: Mtf
    shift_mm: float


def transfer_at(at: Measurement, name: str) -> LocalTransfer | None:
    """Return the MTF at a round body; None, with a warning, if it has none.

    The edge is looked for first, so that a shifted body does not count as blurred.
    """
    pose, radius, height = at.places.body(name)
    voxel = float(at.grid.voxel.min())
    points, values = _around_edge(at, pose, radius, height)
    try:
        place = edge_place(points, values, radius, voxel)
        offset = place.offset_mm(points, radius)
        mtf = edge_mtf(values, offset, radius, voxel, curved=points.shape[1] - 1)
    except InputError as error:
        log.warning("no MTF at %s: %s", name, error)
        return None
    return LocalTransfer(mtf, place.shift_mm)


def _around_edge(
    at: Measurement, pose: Pose, radius_mm: float, height_mm: float | None
) -> tuple[Floats, Floats]:
    """Return voxels near the surface of a sphere, or the lateral surface of a cylinder.

    Returns:
        Their places relative to the body's centre, (n, 3), or to a cylinder's axis, (n, 2), mm;
        their values, (n,).
    """
    reach = (1 + SEARCH) * edge_reach(radius_mm, float(at.grid.voxel.min()))
    if height_mm is None:
        z, y, x = ball(at.grid, pose, radius_mm + reach).box
    else:
        z, y, x = cylinder(at.grid, pose, radius_mm + reach, height_mm).box
    axes = 3 if height_mm is None else 2
    points, values = [np.empty((0, axes))], [np.empty(0)]
    for k in range(z.start, z.stop):  # all positions together would be large
        layer = slice(k, k + 1), y, x
        local = centres(at.grid, layer, pose)
        near = np.abs(np.linalg.norm(local[..., :axes], axis=-1) - radius_mm) <= reach
        if height_mm is not None:
            near &= np.abs(local[..., 2]) <= height_mm / 2
        points.append(local[near][:, :axes])
        values.append(at.volume[layer][near])
    return np.concatenate(points), np.concatenate(values).astype(np.float64)


def _measure(at: Measurement, one: Transfer) -> dict[str, Any]:
    transfer = at.once(transfer_at, one.at)
    if transfer is None:
        return {}
    return {
        "f50_per_mm": transfer.mtf.falls_to(0.5),
        "f10_per_mm": transfer.mtf.falls_to(0.1),
        "shift_mm": transfer.shift_mm,
        "frequency_per_mm": transfer.mtf.frequency_per_mm,
        "mtf": transfer.mtf.value,
    }


def _check(places: NamedPlaces, one: Transfer) -> dict[str, str]:
    pose, radius, _ = places.body(one.at)
    least, result = _LEAST_RADIUS_VOXELS * float(places.grid.voxel.max()), ""
    if radius < least:
        result = (
            f"has a radius of {radius:g} mm; its edge needs at least {least:g} mm, "
            f"{_LEAST_RADIUS_VOXELS:g} voxels"
        )
    elif not len(ball(places.grid, pose, radius)):
        result = "lies outside the grid"
    return {"at": f"{quoted(one.at)} {result}"} if result else {}


MTF = FigureKind(
    "mtf",
    Transfer,
    "Parts and regions at which the modulation transfer is measured.",
    (
        Figure(
            "f50_per_mm",
            "MTF 50 %",
            "mm⁻¹",
            meaning=_FALLS + "half",
            best="higher",
            good="0.6 / voxel edge at best",
            without_signal="null",
            blind_to=("noise", "contrast"),
        ),
        Figure(
            "f10_per_mm",
            "MTF 10 %",
            "mm⁻¹",
            meaning=_FALLS + "tenth",
            best="higher",
            good="0.9 / voxel edge at best",
            without_signal="null",
            blind_to=("noise", "smoothing", "contrast"),
        ),
        Figure(
            "shift_mm",
            "shift of the edge",
            "mm",
            digits=2,
            meaning="of the body's centre; the transfer is measured after it",
            best="lower",
            good="below half a voxel",
            without_signal="null",
            blind_to=(),
        ),
    ),
    _measure,
    names={"at": "round body"},
    check=_check,
    curves=(Curve("mtf", "MTF", "Modulation transfer", _CAPTION),),
)
