"""What is wrong with an arm as its controller knows it: drawn, and put on its kinematics.

Each joint behind its encoder is off by its offset, by the wind-up of its gear under gravity and by
the gear's eccentricity; each frame of base, links and tool is displaced. What is drawn here for a
scan is what a kinematic calibration seeks.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from twinct.draws import scan_rng
from twinct.geometry import Chain, Floats, Misfit
from twinct.scenario import ArmErrors

Frame = Literal["base", "links", "tool"]

S_PER_MIN = 60.0
S_PER_MS = 1e-3


class Spread(NamedTuple):
    """How far frames of a kind are off: independent along and about each of their own axes.

    Attributes:
        term: what it is called.
        frame: which frames.
        sigma: standard deviations of the twist (v, w), (6,), mm and rad.
    """

    term: str
    frame: Frame
    sigma: Floats


class Moment(NamedTuple):
    """What arms do at some instants.

    Attributes:
        joints: what the encoders stand for, (views, joints), rad.
        speeds: (views, joints), rad/s.
        time_s: since the scan began, (views,).
    """

    joints: Floats
    speeds: Floats
    time_s: Floats


@dataclass(frozen=True, eq=False)
class ArmDeviation:
    """How arms differ from their nominal model; the first axis is that of the draws.

    Attributes:
        misfit: of the frames, (draws, ...).
        growth: of each link from cold to warm, along its axes, (draws, joints, 3), mm.
        compliance: of each joint behind its encoder, (draws, joints), rad/(N m).
        gear: gear error of each joint, of the cosine and the sine of the periods of its angle,
            (draws, joints, 2), rad.
    """

    misfit: Misfit
    growth: Floats
    compliance: Floats
    gear: Floats


def spreads(section: ArmErrors) -> Iterator[Spread]:
    """All that displaces frames for a whole scan."""

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
    """Share of the way from cold to warm that is still to go at each time."""
    minutes = section.running_min + time_s / S_PER_MIN
    return np.exp(-minutes / section.warm_up_min)


def mean_compliance(section: ArmErrors, chain: Chain) -> Floats:
    """Of each joint behind its encoder, (joints,), rad/(N m)."""
    return np.radians(section.windup_deg) / chain.torque_limits


def drawn(section: ArmErrors, chain: Chain, seed: int, side: str, draws: int = 1) -> ArmDeviation:
    """Arms of a scenario; the first of many draws is the one of a scan with this seed.

    Args:
        section: how large their errors are.
        chain: the nominal arm.
        seed: of all draws.
        side: ``source`` or ``detector``.
        draws: how many arms.
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
    """Where tools really are while the encoders stand as they do, ``world_from_tool``.

    Args:
        section: periods of the gear and how the arms warm up.
        chain: the nominal arm.
        deviation: the arms that are meant.
        moment: at which instants.
        late_s: from the encoders' reading to the image, (draws, views).

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
