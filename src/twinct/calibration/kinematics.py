"""Calibration of both arms from encoder readings and the poses estimated from a phantom's views.

The model is a product of exponentials in the minimal set. Four numbers move each joint's axis in
its own frame: shifts across the hinge, and turns about the two axes across it. Six numbers move the
detector's tool, three the source's, as a point source shows no more. A slide along a hinge and a
turn about it, and so the joint's zero, are motions of all that follows; they are carried on to the
tool. The base is part of the first axis (Yang, Wu, Li, Chen, Robot. Comput.-Integr. Manuf. 30
(2014) 368: 4 r + 6 numbers for r hinges). Of a rail, only the two tilts of its direction count.
Compliance and gear error of each joint are added. The priors on bases, links, zeros and tools are
transformed to this set, and hold the numbers that the views do not determine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.errors import CalibrationError
from twinct.geometry import Chain, Floats, Pose, ScanGeometry
from twinct.robots.calibrated_arms import SIDES, ArmDeviations, CalibratedArms, changed_tools

AXIS = (0, 1, 3, 4)
"""Components of a joint's twist that move its axis."""

SLIDE = (2, 5)
"""Components of a joint's twist that leave its axis in place."""

SHIFT = (0, 1, 2, 5)
"""Components of a rail's twist that leave its direction in place."""

WORST_MISFIT = 10.0
"""Maximum misfit, residuals over their noise; above it, the views belong to other arms."""

LEFT_OUT = 5
"""Period of the views that are left out and predicted from the others."""

UNSEEN = 0.05
"""Singular values below this count as zero: combinations of such directions are arbitrary."""

PARTS, LEAST_WEIGHT = 6, 0.3
"""Maximum number of parameters named per combination, and their minimum weight."""

_STEP = 1e-3
_TURNS = ("about x", "about y", "about z")


class ArmPrior(NamedTuple):
    """Prior on an arm: standard deviations, for twists (v, w) in mm and rad.

    Attributes:
        base: base frame, including the phantom's place in the room, (6,).
        link: each joint's frame; the last number is the joint's zero, (6,).
        tool: tool frame, (6,).
        compliance: mean of each joint, rad/(N m), (joints,).
        compliance_sigma: standard deviation of each joint, rad/(N m), (joints,).
        gear: cosine and sine amplitudes, rad.
    """

    base: Floats
    link: Floats
    tool: Floats
    compliance: Floats
    compliance_sigma: Floats
    gear: float


@dataclass(frozen=True, eq=False)
class PhantomViews:
    """Calibration data from views of a phantom.

    Attributes:
        joints: encoder readings of both arms, source first, (views, joints), rad.
        geometry: source and panel, in the phantom's frame.
        covariance: covariance of ``resection.PARAMETERS`` in each view, including repeatability,
            (views, 9, 9), mm and rad.
    """

    joints: Floats
    geometry: ScanGeometry
    covariance: Floats

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.joints)

    def __getitem__(self, views: NDArray[np.bool_]) -> PhantomViews:
        """Return the views that a mask selects."""
        return PhantomViews(self.joints[views], self.geometry[views], self.covariance[views])


class UndeterminedByArm(NamedTuple):
    """A combination of parameters that the views determine less well than the prior.

    Attributes:
        arm: source or detector.
        parts: parameters with the largest weights, largest first.
        weights: their weights in prior standard deviations, the largest 1.
        left: remaining share of the prior standard deviation.
    """

    arm: str
    parts: tuple[str, ...]
    weights: tuple[float, ...]
    left: float

    def __str__(self) -> str:
        """Return the combination in words."""
        parts = zip(self.weights, self.parts, strict=True)
        return f"{self.arm} arm: " + ", ".join(f"{weight:+.1f} {part}" for weight, part in parts)


@dataclass(frozen=True, eq=False)
class KinematicCalibration:
    """Result of a kinematic calibration of both arms.

    Attributes:
        arms: calibrated arms.
        names: names of the parameters, source arm first.
        parameters: values, mm, rad, rad/(N m).
        covariance: covariance of the parameters.
        undetermined: combinations that the prior determines.
        misfit: RMS of the residuals in units of their noise.
        left_mm: RMS distances of source and panel centre from the views' estimates.
        predicted_mm: RMS distances of every fifth view, predicted from the others.
        views: number of views.
    """

    arms: CalibratedArms
    names: tuple[str, ...]
    parameters: Floats
    covariance: Floats
    undetermined: tuple[UndeterminedByArm, ...]
    misfit: float
    left_mm: tuple[float, float]
    predicted_mm: tuple[float, float]
    views: int


class _Arm:
    """Minimal set of one arm: ``mean + factor z``, where z has unit variance a priori."""

    def __init__(self, side: str, chain: Chain, prior: ArmPrior, periods: int) -> None:
        self.side, self.chain, self._periods, count = side, chain, periods, len(chain)
        self._tool = 3 if side == "source" else 6
        sigmas = np.concatenate([prior.base, np.tile(prior.link, count), prior.tool])
        known = minimal_from_full(chain)[: 4 * count + self._tool] * sigmas
        # Drop terms that are known exactly, and merge terms that only act together.
        u, s, _ = np.linalg.svd(known, full_matrices=False)
        significant = s > 1e-9 * s.max(initial=0.0)
        gears = np.repeat(prior.gear * chain.hinges, 2)
        joints = np.concatenate([prior.compliance_sigma, gears])
        self.factor = scipy.linalg.block_diag(
            u[:, significant] * s[significant], np.diag(joints)[:, joints > 0]
        )
        self.mean = np.zeros(len(self.factor))
        self.mean[4 * count + self._tool :][:count] = prior.compliance
        names = [f"joint {j + 1} {part}" for j in range(count) for part in ("x", "y", *_TURNS[:2])]
        names += [f"tool {part}" for part in ("x", "y", "z", *_TURNS)][: self._tool]
        names += [f"joint {j + 1} compliance" for j in range(count)]
        names += [f"joint {j + 1} gear {part}" for j in range(count) for part in ("cos", "sin")]
        self.names = tuple(names)

    def change(self, z: Floats) -> ArmDeviations:
        """Return the arm's deviations for z (..., k)."""
        p, count = self.mean + z @ self.factor.T, len(self.chain)
        ends = np.cumsum([4 * count, self._tool, count])
        axes, tool, compliance, gear = np.split(p, ends, axis=-1)
        lead = p.shape[:-1]
        links = np.zeros((*lead, count, 6))
        links[..., AXIS] = axes.reshape(*lead, count, 4)
        whole = np.zeros((*lead, 6))
        whole[..., : self._tool] = tool
        return ArmDeviations(links, whole, compliance, gear.reshape(*lead, count, 2))

    def off(self, z: Floats, seen: PhantomViews, joints: Floats) -> Floats:
        """Return predicted minus measured in panel axes, (..., views, 3 or 6), mm and rad."""
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
    """Return the first-order map from twists of base, joint frames and tool to the minimal set.

    Returns:
        (4 joints + 6, 6 + 6 joints + 6): from base, each joint and tool to the four numbers of each
        joint and the six of the tool.
    """
    count = len(chain)
    full = np.eye(6 * (count + 2)).reshape(count + 2, 6, -1)
    frames = [chain.base, *chain.joints, chain.tool]
    minimal: list[Floats] = []
    carried = here = full[0]
    for joint, (before, after, own) in enumerate(
        zip(frames[:-1], frames[1:], full[1:], strict=True)
    ):
        step = np.linalg.solve(after, before)
        here = Pose.from_matrix(step[:3, 3], step[:3, :3]).adjoint() @ carried + own
        # Some components commute with the joint's motion and pass on to the next frame.
        passed = SHIFT if joint in chain.rails else SLIDE
        carried, remaining = np.zeros_like(here), here.copy()
        carried[list(passed)] = here[list(passed)]
        remaining[list(passed)] = 0.0
        minimal.append(remaining[list(AXIS)])
    return np.concatenate([*minimal[:-1], here])


def calibrated_arms(
    chains: tuple[Chain, Chain],
    seen: PhantomViews,
    priors: tuple[ArmPrior, ArmPrior],
    *,
    gear_periods: int = 1,
) -> KinematicCalibration:
    """Calibrate both arms by weighted least squares with priors.

    Args:
        chains: nominal chains, source first.
        seen: the calibration views.
        priors: prior on each arm.
        gear_periods: periods of the gear error in one turn of a joint.

    Raises:
        CalibrationError: there are too few views, or they do not belong to these arms.
    """
    _require_enough(chains, seen)
    arms = [
        _Arm(side, chain, prior, gear_periods)
        for side, chain, prior in zip(SIDES, chains, priors, strict=True)
    ]
    phantom_from_room = _registered(chains, seen)
    seen = replace(seen, geometry=phantom_from_room.inverse() @ seen.geometry)
    z, jacobian, residuals = _fit(arms, seen)
    zs = np.split(z, [arms[0].factor.shape[1]])
    of_views = jacobian[: 9 * len(seen)]
    # Effective number of parameters that the views, and not the prior, determine.
    values = np.linalg.svd(of_views, compute_uv=False) ** 2
    misfit = np.sqrt((residuals**2).sum() / (9 * len(seen) - (values / (1 + values)).sum()))
    off = [_off(arms, zs, seen)[..., part] for part in (slice(0, 3), slice(3, 6))]
    left_mm = _rms(off[0]), _rms(off[1])
    if misfit > WORST_MISFIT:
        raise CalibrationError(
            f"the joints do not explain the views: the residual is {misfit:.0f} times its noise, "
            f"source {left_mm[0]:.3g} mm, panel {left_mm[1]:.3g} mm RMS; check the signs and order "
            "of the joints, and the kind of arms"
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
        undetermined=tuple(_undetermined(arms, of_views)),
        misfit=float(misfit),
        left_mm=left_mm,
        predicted_mm=_predicted(arms, seen),
        views=len(seen),
    )


def _require_enough(chains: tuple[Chain, Chain], seen: PhantomViews) -> None:
    least = -(-(4 * len(chains[0]) + 3) // 3)
    if len(seen) < least:
        raise CalibrationError(
            f"{len(seen)} views show the arms, but at least {least} are needed: each gives three "
            f"numbers for the {4 * len(chains[0]) + 3} parameters of the source's arm"
        )
    if (count := sum(map(len, chains))) != seen.joints.shape[1]:
        raise CalibrationError(
            f"the views have {seen.joints.shape[1]} joints, but the arms have {count}"
        )


def _registered(chains: tuple[Chain, Chain], seen: PhantomViews) -> Pose:
    """Return the approximate ``phantom_from_room``, by aligning nominal tools with the views.

    The phantom's placement is unknown. To first order, the rest is part of the bases' errors.
    """
    own = np.split(seen.joints, [len(chains[0])], axis=1)
    room = np.concatenate([c.tools(q)[:, :3, 3] for c, q in zip(chains, own, strict=True)])
    phantom = np.concatenate([seen.geometry.source, seen.geometry.detector])
    middles = room.mean(axis=0), phantom.mean(axis=0)
    offsets = phantom - middles[1], room - middles[0]
    turn, _ = scipy.spatial.transform.Rotation.align_vectors(*offsets)
    return Pose(middles[1] - turn.apply(middles[0]), turn.as_quat())


def _fit(arms: Sequence[_Arm], seen: PhantomViews) -> tuple[Floats, Floats, Floats]:
    """Return the minimum, its Jacobian with the prior's rows last, and the views' residuals."""
    # L^-1 whitens a residual of covariance C = L L'.
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

    fit = scipy.optimize.least_squares(left, np.zeros(sum(sizes)), jac=slopes, method="lm")
    return fit.x, slopes(fit.x), left(fit.x)[: 9 * len(seen)]


def _off(arms: Sequence[_Arm], zs: Sequence[Floats], seen: PhantomViews) -> Floats:
    first = len(arms[0].chain)
    joints = seen.joints[:, :first], seen.joints[:, first:]
    off = [arm.off(z, seen, own) for arm, z, own in zip(arms, zs, joints, strict=True)]
    return np.concatenate(off, axis=-1)


def _predicted(arms: Sequence[_Arm], seen: PhantomViews) -> tuple[float, float]:
    out = np.arange(len(seen)) % LEFT_OUT == LEFT_OUT - 1
    z = _fit(arms, seen[~out])[0]
    off = _off(arms, np.split(z, [arms[0].factor.shape[1]]), seen[out])
    return _rms(off[:, :3]), _rms(off[:, 3:6])


def _rms(off: Floats) -> float:
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


def _undetermined(arms: Sequence[_Arm], determined: Floats) -> list[UndeterminedByArm]:
    """Return the combinations whose singular values are below 1: the prior knows them better."""
    undetermined: list[UndeterminedByArm] = []
    for arm, own in zip(arms, np.split(determined, [arms[0].factor.shape[1]], axis=1), strict=True):
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
            undetermined.append(
                UndeterminedByArm(arm.side, parts, tuple(map(float, weights[most])), left)
            )
    return undetermined


def _apart(loads: Floats) -> Floats:
    """Return a basis of the same space where each vector has a parameter that no other has."""
    if not len(loads):
        return loads
    pivots = scipy.linalg.qr(loads, mode="r", pivoting=True)[-1][: len(loads)]
    return np.asarray(np.linalg.solve(loads[:, pivots], loads), np.float64)
