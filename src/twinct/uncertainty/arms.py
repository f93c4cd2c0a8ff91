"""Deviations of an arm from its controller's model: random draws, and the resulting kinematics.

Behind its encoder, each joint deviates by its offset, by the wind-up of its gear under gravity and
by the gear's eccentricity. Each frame of base, links and tool is displaced. A kinematic
calibration estimates the deviations that are drawn here for a scan.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from twinct.core.draws import scan_rng
from twinct.geometry import Chain, Floats, Misfit
from twinct.scenario import ArmErrors

Frame = Literal["base", "links", "tool"]

S_PER_MIN = 60.0
S_PER_MS = 1e-3


class Spread(NamedTuple):
    """Spread of frame displacements, independent along and about each of the frame's axes.

    Attributes:
        term: name of the cause.
        frame: kind of the displaced frames.
        sigma: standard deviations of the twist (v, w), (6,), mm and rad.
    """

    term: str
    frame: Frame
    sigma: Floats


class Moment(NamedTuple):
    """Motion of an arm at some instants.

    Attributes:
        joints: joint positions by the encoders, (views, joints), rad.
        speeds: joint speeds, (views, joints), rad/s.
        time_s: time since the scan began, (views,).
    """

    joints: Floats
    speeds: Floats
    time_s: Floats


@dataclass(frozen=True, eq=False)
class ArmDeviation:
    """Deviations of arms from their nominal model; draws are the first axis.

    Attributes:
        misfit: displacements of the frames, (draws, ...).
        growth: growth of each link from cold to warm, along its axes, (draws, joints, 3), mm.
        compliance: compliance of each joint behind its encoder, (draws, joints), rad/(N m).
        gear: gear error of each joint: amplitudes of cosine and sine of the joint angle times
            ``gear_periods``, (draws, joints, 2), rad.
    """

    misfit: Misfit
    growth: Floats
    compliance: Floats
    gear: Floats


def spreads(section: ArmErrors) -> Iterator[Spread]:
    """Yield the spread of each cause that displaces frames for a whole scan."""

    def both(mm: float, deg: float) -> Floats:
        return np.array([mm] * 3 + [np.radians(deg)] * 3)

    yield Spread("joint offset", "links", both(0, section.joint_offset_deg) * (0, 0, 0, 0, 0, 1))
    yield Spread("link", "links", both(section.link_mm, section.link_deg) * (1, 1, 1, 1, 1, 0))
    yield Spread("base", "base", both(section.base_mm, section.base_deg))
    yield Spread("tool", "tool", both(section.tool_mm, section.tool_deg))
    aged = both(section.ageing_mm, section.ageing_deg) * np.sqrt(section.age_months)
    yield Spread("ageing", "base", aged)
    yield Spread("ageing", "tool", aged)


def coldness(section: ArmErrors, time_s: Floats) -> Floats:
    """Return the remaining share of the warm-up at each time."""
    minutes = section.running_min + time_s / S_PER_MIN
    return np.exp(-minutes / section.warm_up_min)


def mean_compliance(section: ArmErrors, chain: Chain) -> Floats:
    """Return the mean compliance of each joint behind its encoder, (joints,), rad/(N m)."""
    return np.radians(section.windup_deg) / chain.torque_limits


def drawn(section: ArmErrors, chain: Chain, seed: int, side: str, draws: int = 1) -> ArmDeviation:
    """Draw the deviations of arms; the first draw equals the arms of a scan with this seed.

    Args:
        section: sizes of the errors.
        chain: nominal arm.
        seed: seed of all draws.
        side: ``source`` or ``detector``.
        draws: number of arms.
    """
    joints = len(chain)

    def normals(term: str, *shape: int) -> Floats:
        return scan_rng(seed, f"{side} arm {term}").normal(size=(draws, *shape))

    twists = {"base": np.zeros((draws, 6)), "links": np.zeros((draws, joints, 6))}
    twists["tool"] = np.zeros((draws, 6))
    for term, frame, sigma in spreads(section):
        twists[frame] += sigma * normals(f"{term} {frame}", *twists[frame].shape[1:])
    varied = 1 + section.windup_spread * normals("windup", joints)
    phase = scan_rng(seed, f"{side} arm gear").uniform(0, 2 * np.pi, (draws, joints))
    return ArmDeviation(
        misfit=Misfit(**twists),
        growth=section.drift_mm * normals("drift", joints, 3),
        compliance=mean_compliance(section, chain) * varied,
        gear=np.radians(section.gear_deg) * np.stack([np.sin(phase), np.cos(phase)], axis=-1),
    )


def true_tools(
    section: ArmErrors, chain: Chain, deviation: ArmDeviation, moment: Moment, late_s: Floats
) -> Floats:
    """Compute the executed poses of tools from encoder readings, ``world_from_tool``.

    Args:
        section: gear periods and warm-up of the arms.
        chain: nominal arm.
        deviation: deviations of the arms.
        moment: motion at some instants.
        late_s: delay from the encoder reading to the image, (draws, views).

    Returns:
        (draws, views, 4, 4), mm.
    """
    behind = deviation.compliance[:, None] * chain.gravity_torques(moment.joints)
    turns = section.gear_periods * moment.joints
    cosine, sine = np.moveaxis(deviation.gear[:, None], -1, 0)
    behind = behind + cosine * np.cos(turns) + sine * np.sin(turns)
    behind = behind + late_s[..., None] * moment.speeds
    misfit = deviation.misfit
    links = misfit.links[:, None]
    if section.drift_mm:
        missing = coldness(section, moment.time_s)[:, None, None] * deviation.growth[:, None]
        twists = np.concatenate([-missing, np.zeros_like(missing)], axis=-1)
        links = links + twists
    here = replace(misfit, base=misfit.base[:, None], links=links, tool=misfit.tool[:, None])
    return chain.tools(moment.joints + behind, here)
