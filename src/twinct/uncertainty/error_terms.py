"""Error terms: kinds of deviation of the executed poses; other packages offer theirs, too.

A term states how far it spreads. Random draws, first-order covariances and the prior of a
calibration follow from that alone. Entry points ``twinct.errors`` name the terms of other packages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic.fields import FieldInfo

from twinct.core.settings import Section, setting
from twinct.geometry import Chain, Misfit

Array = NDArray[np.float64]

SIDES = ("source", "detector")

CONSTANT = math.inf
"""Correlation length of errors that are constant over a scan."""

Place = Literal["base", "links", "joints", "tool", "pose"]
"""Deviating part: frames of an arm, its joints behind their encoders, or, with a gantry as well,
the executed pose of source or panel."""


_SIZE = object()


def size(description: str, *, signed: bool = False) -> Any:
    """Return the field of a key that makes executed poses deviate unless it is 0, its default.

    It takes no number below 0 unless it is ``signed``.
    """
    bounds: dict[str, Any] = {} if signed else {"ge": 0}
    field: FieldInfo = setting(0.0, description, **bounds)
    field.metadata.append(_SIZE)
    return field


class ErrorSettings(Section):
    """Keys of error terms, in a section of ``uncertainty``."""

    def of(self, side: str) -> ErrorSettings:
        """Return the settings of the source or the detector, which most errors share."""
        del side
        return self

    @property
    def sizes(self) -> tuple[float, ...]:
        """Values of the keys that are made by ``size``: without them, nothing deviates."""
        fields = type(self).model_fields.items()
        return tuple(getattr(self, name) for name, info in fields if _SIZE in info.metadata)


class ToolMotion(NamedTuple):
    """Motion of one end-effector over some views, as the controllers believe it.

    Attributes:
        side: ``source`` or ``detector``.
        poses: ``world_from_tool``, (views, 4, 4), mm.
        time_s: time since the scan began, (views,).
        chain: nominal arm; None with a gantry.
        joints: joint positions by the encoders, (views, joints), rad; (views, 0) with a gantry.
        speeds: joint speeds, (views, joints), rad/s.
        accelerations: planned joint accelerations at some times, (times, joints), rad/s^2, before
            the views as well; None if nothing moves by a plan.
    """

    side: str
    poses: Array
    time_s: Array
    chain: Chain | None
    joints: Array
    speeds: Array
    accelerations: Callable[[Array], Array] | None = None


def own_accelerations(
    both: Callable[[Array], Array] | None, own: slice
) -> Callable[[Array], Array] | None:
    """Return the accelerations of one arm's joints from those of both arms."""
    return None if both is None else lambda times: both(times)[:, own]


class Spread(NamedTuple):
    """Standard deviations of an error that is linear in standard normal draws.

    Attributes:
        place: deviating part.
        sigma: rad for ``joints``, (joints,) or (views, joints). Else twists (v, w) in the axes of
            each frame, mm and rad: (6,) or (views, 6); of ``links`` (6,), (joints, 6) or
            (views, joints, 6).
        length: correlation length of the draws in views: ``CONSTANT``, a number, or 0.
        draws: one draw for ``each`` number, one for each ``side``, one for ``all`` of both sides;
            ``none`` for a systematic error, which is ``sigma`` itself.
    """

    place: Place
    sigma: Array
    length: float = CONSTANT
    draws: Literal["each", "side", "all", "none"] = "each"


class ViewDraws(Protocol):
    """Standard normal draws of some views."""

    def __call__(self, purpose: str, size: int, length: float, /) -> Array | None:
        """Return draws, (draws, views, size); None outside the views of a scan."""
        ...


class ScanDraws(Protocol):
    """Draws that are constant over a scan.

    Attributes:
        count: number of scans.
    """

    count: int

    def rng(self, purpose: str) -> np.random.Generator:
        """Return the generator of a purpose, keyed by the side as well."""
        ...


ArmShift = Callable[[ToolMotion, ViewDraws], Misfit]
"""Deviation of an arm at some views; first axes: draws and views."""


@dataclass(frozen=True, eq=False)
class ErrorTerm:
    """Kind of deviation of the executed poses from those that the controllers believe.

    Attributes:
        name: name of the cause in tables.
        settings: class of its keys.
        spreads: spreads of one side from settings and motion; they must yield the same places for
            all views.
        places: all places that the spreads may have; a machine without arms has the ``pose`` alone.
        section: key below ``uncertainty`` that holds the settings; empty: the name.
        drawn: its own draws for an arm, where they are not linear in normal draws; None: draws of
            the spreads.
        prior: standard deviations of twists of base, links and tool in the prior of a calibration,
            which has parameters of its own for compliance and gears; None: the spreads.
        purpose: key of the draws of poses; empty: the name.
    """

    name: str
    settings: type[ErrorSettings]
    spreads: Callable[[Any, ToolMotion], Iterable[Spread]]
    places: tuple[Place, ...] = ("pose",)
    section: str = ""
    drawn: Callable[[Any, Chain, ScanDraws], ArmShift] | None = None
    prior: Callable[[Any], dict[str, Array]] | None = None
    purpose: str = ""
