"""Keys that several algorithms share, with their meanings and limits."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from twinct.core.settings import facts
from twinct.recon.order import OrderName

_PAPER = facts(source="the paper")

Iterations = Annotated[
    int, Field(ge=1, le=10_000, description="Passes over all views.", json_schema_extra=_PAPER)
]
Passes = Annotated[
    int,
    Field(
        ge=1,
        le=1000,
        description="Most passes over all views at full resolution, after one of SART.",
    ),
]
Tolerance = Annotated[
    float,
    Field(
        gt=0,
        lt=1,
        description="The passes end when one changes the volume by less than this share (root mean "
        "squares).",
    ),
]
Relaxation = Annotated[
    float,
    Field(
        gt=0,
        lt=2,
        description="Share of the residual that each update applies.",
        json_schema_extra=_PAPER,
    ),
]
Ordering = Annotated[
    OrderName,
    Field(
        description="Order of the views.",
        json_schema_extra=facts(source="weighted_distance: Mueller, Yagel and Cornhill 1997"),
    ),
]
Subsets = Annotated[
    int | None, Field(ge=1, description="Number of groups of views; by default one per 10 views.")
]
StopName = Literal["auto"]
Stop = Annotated[
    StopName | None,
    Field(
        description="auto: the algorithm chooses the number of passes, at most the stated number "
        "(docs/reconstruction.md)."
    ),
]
Nonnegative = Annotated[bool, Field(description="Whether voxels are kept at 0 or above.")]
