"""Both arms from the poses that a phantom's views gave, and what the encoders read there.

Products of exponentials in the minimal set: each joint's axis is moved by four numbers in its own
frame (across the hinge and about the two axes across it), the tool by six, or by the three that a
point source shows. A slide along a hinge and a turn about it, so also the joint's zero, are motions
of all that follows, which reach the tool; the base is in the first axis (Yang, Wu, Li, Chen, Robot.
Comput.-Integr. Manuf. 30 (2014) 368: 4 r + 6 numbers for r hinges). Beside these compliance and
gear error of each joint. What is known beforehand of bases, links, zeros and tools is carried to
this set, and holds what the views do not tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.calibration.arms import SIDES, CalibratedArms, Change, changed_tools
from twinct.errors import CalibrationError
from twinct.geometry import Chain, Floats, Pose, ScanGeometry

AXIS = (0, 1, 3, 4)
"""Of a joint's twist what moves its axis."""

SLIDE = (2, 5)
"""And what does not."""

WORST_MISFIT = 10.0
"""Residuals so many times their noise are not of these arms."""

LEFT_OUT = 5
"""Every so manieth view is predicted from the others."""

UNSEEN = 0.05
"""Singular values below are as good as none: of these combinations any mixture is left, too."""

PARTS, LEAST_WEIGHT = 6, 0.3
"""Of a combination so many parameters are named, those that weigh at least so much."""

_STEP = 1e-3
_TURNS = ("about x", "about y", "about z")


class ArmPrior(NamedTuple):
    """What is known of an arm before: standard deviations, of twists (v, w), mm and rad.

    Attributes:
        base: of the base's frame, the phantom's place in the room included, (6,).
        link: of each joint's frame, its last number that of the joint's zero, (6,).
        tool: (6,).
        compliance: mean of each joint, rad/(N m), (joints,).
        compliance_sigma: (joints,).
        gear: of cosine and sine, rad.
    """

    base: Floats
    link: Floats
    tool: Floats
    compliance: Floats
    compliance_sigma: Floats
    gear: float


@dataclass(frozen=True, eq=False)
class Seen:
    """What some views of a phantom tell.

    Attributes:
        joints: what the encoders read, both arms, source first, (views, joints), rad.
        geometry: source and panel, in the phantom's frame.
        covariance: of ``resection.PARAMETERS`` in each view, repeatability included,
            (views, 9, 9), mm and rad.
    """

    joints: Floats
    geometry: ScanGeometry
    covariance: Floats

    def __len__(self) -> int:
        """Number of views."""
        return len(self.joints)

    def __getitem__(self, views: NDArray[np.bool_]) -> Seen:
        """Some of them, by a mask."""
        return Seen(self.joints[views], self.geometry[views], self.covariance[views])


class Untold(NamedTuple):
    """A combination of parameters of which the views tell less than was known before.

    Attributes:
        arm: source or detector.
        parts: its parameters that count most, the largest first.
        weights: of them, in standard deviations of what was known, the largest 1.
        left: share of the standard deviation that is left of it.
    """

    arm: str
    parts: tuple[str, ...]
    weights: tuple[float, ...]
    left: float

    def __str__(self) -> str:
        """In words."""
        parts = zip(self.weights, self.parts, strict=True)
        return f"{self.arm} arm: " + ", ".join(f"{weight:+.1f} {part}" for weight, part in parts)


@dataclass(frozen=True, eq=False)
class KinematicCalibration:
    """What a phantom's views say of both arms.

    Attributes:
        arms: as they were found.
        names: of the parameters, source arm first.
        parameters: their values, mm, rad, rad/(N m).
        covariance: of them.
        untold: combinations that stay where they were taken to be.
        misfit: RMS of residuals in units of their noise.
        left_mm: RMS distance of source and panel centre from where the views saw them.
        predicted_mm: the same of every fifth view, predicted from the others.
        views: how many told.
    """

    arms: CalibratedArms
    names: tuple[str, ...]
    parameters: Floats
    covariance: Floats
    untold: tuple[Untold, ...]
    misfit: float
    left_mm: tuple[float, float]
    predicted_mm: tuple[float, float]
    views: int


class _Arm:
    """The minimal set of one arm: ``mean + factor z`` with z of unit variance before."""

    def __init__(self, side: str, chain: Chain, prior: ArmPrior, periods: int) -> None:
        self.side, self.chain, self._periods, count = side, chain, periods, len(chain)
        self._tool = 3 if side == "source" else 6
        sigmas = np.concatenate([prior.base, np.tile(prior.link, count), prior.tool])
        known = minimal_from_full(chain)[: 4 * count + self._tool] * sigmas
        # Terms that are known for certain drop out; those that only act together count once.
        u, s, _ = np.linalg.svd(known, full_matrices=False)
        kept = s > 1e-9 * s.max(initial=0.0)
        joints = np.concatenate([prior.compliance_sigma, np.full(2 * count, prior.gear)])
        self.factor = scipy.linalg.block_diag(u[:, kept] * s[kept], np.diag(joints)[:, joints > 0])
        self.mean = np.zeros(len(self.factor))
        self.mean[4 * count + self._tool :][:count] = prior.compliance
        names = [f"joint {j + 1} {part}" for j in range(count) for part in ("x", "y", *_TURNS[:2])]
        names += [f"tool {part}" for part in ("x", "y", "z", *_TURNS)][: self._tool]
        names += [f"joint {j + 1} compliance" for j in range(count)]
        names += [f"joint {j + 1} gear {part}" for j in range(count) for part in ("cos", "sin")]
        self.names = tuple(names)

    def change(self, z: Floats) -> Change:
        """Of the arm, z (..., k)."""
        p, count = self.mean + z @ self.factor.T, len(self.chain)
        ends = np.cumsum([4 * count, self._tool, count])
        axes, tool, compliance, gear = np.split(p, ends, axis=-1)
        lead = p.shape[:-1]
        links = np.zeros((*lead, count, 6))
        links[..., AXIS] = axes.reshape(*lead, count, 4)
        whole = np.zeros((*lead, 6))
        whole[..., : self._tool] = tool
        return Change(links, whole, compliance, gear.reshape(*lead, count, 2))

    def off(self, z: Floats, seen: Seen, joints: Floats) -> Floats:
        """Predicted less seen, in the panel's axes, (..., views, 3 or 6), mm and rad."""
        tools = changed_tools(self.chain, self.change(z), self._periods, joints)
        view = seen.geometry
        axes = np.stack([view.u, view.v, view.normal], axis=-1)
        place = view.source if self.side == "source" else view.detector
        moved = np.einsum("vij,...vi->...vj", axes, tools[..., :3, 3] - place)
        if self.side == "source":
            return moved
        turned = axes.transpose(0, 2, 1) @ tools[..., :3, :3]
        turns = scipy.spatial.transform.Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec()
        return np.concatenate([moved, turns.reshape(moved.shape)], axis=-1)


def minimal_from_full(chain: Chain) -> Floats:
    """To first order what twists of base, joints' frames and tool are in the minimal set.

    Returns:
        (4 joints + 6, 6 + 6 joints + 6): from base, each joint, tool to the four numbers of each
        joint and the tool's six.
    """
    count = len(chain)
    full = np.eye(6 * (count + 2)).reshape(count + 2, 6, -1)
    frames = [chain.base, *chain.joints, chain.tool]
    found: list[Floats] = []
    carried = here = full[0]
    for before, after, own in zip(frames[:-1], frames[1:], full[1:], strict=True):
        step = np.linalg.solve(after, before)
        here = Pose.from_matrix(step[:3, 3], step[:3, :3]).adjoint() @ carried + own
        found.append(here[list(AXIS)])
        carried = np.zeros_like(here)
        # These commute with the joint's turn, and go on to what follows.
        carried[list(SLIDE)] = here[list(SLIDE)]
    return np.concatenate([*found[:-1], here])


def calibrated_arms(
    chains: tuple[Chain, Chain],
    seen: Seen,
    priors: tuple[ArmPrior, ArmPrior],
    *,
    gear_periods: int = 1,
) -> KinematicCalibration:
    """Both arms by weighted least squares under priors.

    Args:
        chains: nominal ones, source first.
        seen: what the views tell.
        priors: what is known before.
        gear_periods: of the gear error in a turn of a joint.

    Raises:
        CalibrationError: too few views, or views that are of no such arms.
    """
    least = -(-(4 * len(chains[0]) + 3) // 3)
    if len(seen) < least:
        raise CalibrationError(
            f"{len(seen)} views tell of the arms, at least {least} are needed: three numbers each "
            f"for {4 * len(chains[0]) + 3} of the source's arm"
        )
    if (count := sum(map(len, chains))) != seen.joints.shape[1]:
        raise CalibrationError(f"views tell {seen.joints.shape[1]} joints, the arms have {count}")
    arms = [
        _Arm(side, chain, prior, gear_periods)
        for side, chain, prior in zip(SIDES, chains, priors, strict=True)
    ]
    phantom_from_room = _registered(chains, seen)
    seen = replace(seen, geometry=phantom_from_room.inverse() @ seen.geometry)
    z, jacobian, residuals = _fit(arms, seen)
    zs = np.split(z, [arms[0].factor.shape[1]])
    told = jacobian[: 9 * len(seen)]
    # Of the numbers that are seen, so many went into what the views tell.
    values = np.linalg.svd(told, compute_uv=False) ** 2
    misfit = np.sqrt((residuals**2).sum() / (9 * len(seen) - (values / (1 + values)).sum()))
    off = [_off(arms, zs, seen)[..., part] for part in (slice(0, 3), slice(3, 6))]
    left_mm = _rms(off[0]), _rms(off[1])
    if misfit > WORST_MISFIT:
        raise CalibrationError(
            f"the joints do not explain the views: what is left is {misfit:.0f} times its noise, "
            f"source {left_mm[0]:.3g} mm, panel {left_mm[1]:.3g} mm RMS; a joint's sign or order, "
            "or arms of another kind"
        )
    factor = scipy.linalg.block_diag(*(arm.factor for arm in arms))
    spread = np.linalg.inv(jacobian.T @ jacobian) * max(misfit, 1.0) ** 2
    parameters = np.concatenate([arm.mean for arm in arms]) + factor @ z
    changes = arms[0].change(zs[0]), arms[1].change(zs[1])
    made_by = {
        "model": "kinematics",
        "views": len(seen),
        "misfit": round(float(misfit), 3),
    }
    return KinematicCalibration(
        arms=CalibratedArms(chains, changes, gear_periods, phantom_from_room, made_by),
        names=tuple(f"{arm.side} {name}" for arm in arms for name in arm.names),
        parameters=parameters,
        covariance=factor @ spread @ factor.T,
        untold=tuple(_untold(arms, told)),
        misfit=float(misfit),
        left_mm=left_mm,
        predicted_mm=_predicted(arms, seen),
        views=len(seen),
    )


def _registered(chains: tuple[Chain, Chain], seen: Seen) -> Pose:
    """About where the room is in the phantom's frame, by what nominal arms make of all views.

    Nobody knows how the phantom was put there; to first order the rest is the bases' own.
    """
    own = np.split(seen.joints, [len(chains[0])], axis=1)
    room = np.concatenate([c.tools(q)[:, :3, 3] for c, q in zip(chains, own, strict=True)])
    phantom = np.concatenate([seen.geometry.source, seen.geometry.detector])
    middles = room.mean(axis=0), phantom.mean(axis=0)
    offsets = phantom - middles[1], room - middles[0]
    turn, _ = scipy.spatial.transform.Rotation.align_vectors(*offsets)
    return Pose(middles[1] - turn.apply(middles[0]), turn.as_quat())


def _fit(arms: Sequence[_Arm], seen: Seen) -> tuple[Floats, Floats, Floats]:
    """The minimum, the Jacobian there with the prior's rows last, and the views' residuals."""
    # L^-1 of C = L L' whitens.
    whiten = np.linalg.inv(np.linalg.cholesky(seen.covariance))
    sizes = [arm.factor.shape[1] for arm in arms]
    first = len(arms[0].chain)
    joints = seen.joints[:, :first], seen.joints[:, first:]
    columns = slice(0, 3), slice(3, 9)

    def left(z: Floats) -> Floats:
        off = _off(arms, np.split(z, [sizes[0]]), seen)
        return np.concatenate([np.einsum("vij,vj->vi", whiten, off).ravel(), z])

    def slopes(z: Floats) -> Floats:
        parts = []
        zs = np.split(z, [sizes[0]])
        for arm, at, own, column in zip(arms, zs, joints, columns, strict=True):
            steps = _STEP * np.eye(len(at))
            change = arm.off(at + steps, seen, own) - arm.off(at - steps, seen, own)
            slope = np.einsum("vij,kvj->vik", whiten[:, :, column], change / (2 * _STEP))
            parts.append(slope.reshape(-1, len(at)))
        return np.concatenate([np.concatenate(parts, axis=1), np.eye(len(z))])

    found = scipy.optimize.least_squares(left, np.zeros(sum(sizes)), jac=slopes, method="lm")
    return found.x, slopes(found.x), left(found.x)[: 9 * len(seen)]


def _off(arms: Sequence[_Arm], zs: Sequence[Floats], seen: Seen) -> Floats:
    first = len(arms[0].chain)
    joints = seen.joints[:, :first], seen.joints[:, first:]
    off = [arm.off(z, seen, own) for arm, z, own in zip(arms, zs, joints, strict=True)]
    return np.concatenate(off, axis=-1)


def _predicted(arms: Sequence[_Arm], seen: Seen) -> tuple[float, float]:
    out = np.arange(len(seen)) % LEFT_OUT == LEFT_OUT - 1
    z = _fit(arms, seen[~out])[0]
    off = _off(arms, np.split(z, [arms[0].factor.shape[1]]), seen[out])
    return _rms(off[:, :3]), _rms(off[:, 3:6])


def _rms(off: Floats) -> float:
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


def _untold(arms: Sequence[_Arm], told: Floats) -> list[Untold]:
    """By the singular values of each arm's whitened Jacobian: below 1 the prior knows more."""
    found: list[Untold] = []
    for arm, own in zip(arms, np.split(told, [arms[0].factor.shape[1]], axis=1), strict=True):
        _, values, directions = np.linalg.svd(own)
        values = np.concatenate([values, np.zeros(len(directions) - len(values))])
        sigma = np.linalg.norm(arm.factor, axis=1)
        loads = directions @ (arm.factor / np.where(sigma > 0, sigma, 1.0)[:, None]).T
        unseen = values < UNSEEN
        loads[unseen] = _apart(loads[unseen])
        for value, load in zip(values, loads, strict=True):
            if value >= 1:
                continue
            order = np.argsort(-np.abs(load), kind="stable")
            weights = load / load[order[0]]
            most = [i for i in order[:PARTS] if abs(weights[i]) > LEAST_WEIGHT]
            parts = tuple(arm.names[i] for i in most)
            left = float(1 / np.sqrt(1 + value**2))
            found.append(Untold(arm.side, parts, tuple(map(float, weights[most])), left))
    return found


def _apart(loads: Floats) -> Floats:
    """Other vectors of the same space, each with a parameter that none of the others has."""
    if not len(loads):
        return loads
    pivots = scipy.linalg.qr(loads, mode="r", pivoting=True)[-1][: len(loads)]
    return np.asarray(np.linalg.solve(loads[:, pivots], loads), np.float64)
