"""Effects of a scenario's errors on the geometry of its views, computed before anything moves.

An error separates an executed pose from a believed pose: displacement and rotation of a tool,
(v, w) in mm and rad, both in world axes. The errors of source and panel are stacked, (12,). A
moving specimen counts as the opposite motion of both.

To first order, each term causes a zero-mean error that is linear in standard normal draws. Its
factor F_v in view v gives the covariance r(v, w) F_v F_w' of two views. Here r is 1 for errors that
are constant over a scan, exp(-d^2 / 2 length^2) at a distance of d views for correlated errors, and
0 for errors that are drawn anew. A gear error of random phase is a cosine and a sine of independent
amplitudes, whose covariance is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.draws import scan_rng
from twinct.geometry import Chain, Floats, Panel, ScanGeometry, exp_matrices, lock
from twinct.scenario import PoseNoise, Uncertainty
from twinct.uncertainty.arms import (
    S_PER_MS,
    ArmDeviation,
    Moment,
    coldness,
    drawn,
    mean_compliance,
    spreads,
    true_tools,
)
from twinct.uncertainty.correlation import weights
from twinct.uncertainty.executed import SIDES, view_sigmas
from twinct.uncertainty.patient import amplitudes, directions, patient_twists

Singles = NDArray[np.float32]
"""Type of millions of draws, whose rounding is negligible against their spread."""

CONSTANT = np.inf
"""Correlation length of errors that are constant over a scan."""

CHUNK = 50_000
"""Number of poses of each arm that are drawn at a time."""

STEP = 1e-3
"""Step of the difference quotients of projections, mm and rad."""


@dataclass(frozen=True, eq=False)
class NominalScan:
    """Views of a scan in the controllers' nominal model.

    Attributes:
        poses: ``world_from_source`` and ``world_from_detector``, (2, views, 4, 4), mm.
        time_s: time since the scan began, (views,).
        chains: source and detector arm; none with a gantry.
        moments: motion of each arm.
    """

    poses: Floats
    time_s: Floats
    chains: tuple[Chain, ...] = ()
    moments: tuple[Moment, ...] = ()

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        lock(self, "poses", "time_s")

    @classmethod
    def of_arms(
        cls, chains: tuple[Chain, Chain], joints: Floats, speeds: Floats, time_s: Floats
    ) -> NominalScan:
        """Build a scan from the joints of both arms, source first, (views, joints), rad and s."""
        first = len(chains[0])
        moments = tuple(
            Moment(joints[:, own], speeds[:, own], time_s)
            for own in (slice(None, first), slice(first, None))
        )
        poses = [chain.tools(one.joints) for chain, one in zip(chains, moments, strict=True)]
        return cls(np.stack(poses), time_s, chains, moments)

    @classmethod
    def of_gantry(cls, views: ScanGeometry, time_s: Floats) -> NominalScan:
        """Build a scan from the views of a gantry."""
        sides = views.source_poses(), views.detector_poses()
        return cls(np.array([[pose.matrix for pose in side] for side in sides]), time_s)


@dataclass(frozen=True, eq=False)
class Term:
    """First-order effect of one cause on all views.

    Attributes:
        name: name of the cause.
        factor: errors per standard draw, (views, 12, draws), mm and rad.
        length: correlation length in views: ``CONSTANT``, a number, or 0.
    """

    name: str
    factor: Floats
    length: float

    def alike(self, apart: Floats) -> Floats:
        """Return the correlation of the draws of two views at a distance of ``apart`` views."""
        if self.length == CONSTANT:
            return np.ones_like(apart, dtype=float)
        if not self.length:
            return (apart == 0).astype(float)
        return np.exp(-((apart / self.length) ** 2) / 2)


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """First-order covariances of all views, and their means.

    Attributes:
        terms: all random causes.
        means: systematic errors that are equal in all draws, each with a draw of 1.
        views: number of views.
    """

    terms: tuple[Term, ...]
    means: tuple[Term, ...]
    views: int

    def covariance(self, one: int, other: int) -> Floats:
        """Return the covariance of the errors of view ``one`` (rows) and ``other``, (12, 12)."""
        found = np.zeros((12, 12))
        for term in self.terms:
            apart = np.array(float(one - other))
            found += term.alike(apart) * term.factor[one] @ term.factor[other].T
        return found

    @cached_property
    def covariances(self) -> Floats:
        """Covariance of the errors within each view, (views, 12, 12)."""
        return sum(
            (term.factor @ np.swapaxes(term.factor, 1, 2) for term in self.terms),
            np.zeros((self.views, 12, 12)),
        )


def first_order(section: Uncertainty, scan: NominalScan) -> FirstOrder:
    """Compute the first-order covariances of a scenario's errors, without draws."""
    found = [
        *(_of_arms(section, scan) if scan.chains else ()),
        *_of_views(section, scan),
        *_reported(section),
    ]
    views = len(scan.time_s)
    means = _means(section, scan) if scan.chains else ()
    terms: dict[tuple[str, float], list[Floats]] = {}
    for term in found:
        if term.factor.any():
            factor = np.broadcast_to(term.factor, (views, *term.factor.shape[1:]))
            terms.setdefault((term.name, term.length), []).append(factor)
    joined = tuple(
        Term(name, np.concatenate(parts, axis=2), length) for (name, length), parts in terms.items()
    )
    return FirstOrder(joined, tuple(term for term in means if term.factor.any()), views)


def _carried(frames: Floats, tools: Floats) -> Floats:
    """Return matrices from twists of frames, in their axes, to errors of tools, (..., 6, 6)."""
    rotation = frames[..., :3, :3]
    arms = tools[..., :3, 3] - frames[..., :3, 3]
    found = np.zeros((*rotation.shape[:-2], 6, 6))
    found[..., :3, :3] = found[..., 3:, 3:] = rotation
    # The columns are w x r for each axis of the frame.
    turned = np.cross(np.swapaxes(rotation, -1, -2), arms[..., None, :])
    found[..., :3, 3:] = np.swapaxes(turned, -1, -2)
    return found


def _of_side(side: int, factor: Floats) -> Floats:
    """Extend a factor of one end-effector, (views, 6, draws), to both, (views, 12, draws)."""
    both = np.zeros((len(factor), 12, factor.shape[2]))
    both[:, 6 * side : 6 * side + 6] = factor
    return both


def _of_arms(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    arms, views = section.arms, len(scan.time_s)
    missed = np.zeros((views, 12, 1))
    for side, (chain, moment) in enumerate(zip(scan.chains, scan.moments, strict=True)):
        tools = scan.poses[side]
        frames = chain.frames(moment.joints)[:, :-1]
        # A link's errors refer to the axes of its frame before the rotation of the joint.
        still = frames @ np.linalg.inv(exp_matrices(_about_z(moment.joints)))
        places = {
            "base": _carried(np.broadcast_to(chain.base, tools.shape), tools)[:, None],
            "links": _carried(still, tools[:, None]),
            "tool": _carried(tools, tools)[:, None],
        }
        for term, frame, sigma in spreads(arms):
            factor = places[frame] * sigma
            yield Term(term, _of_side(side, _columns(factor)), CONSTANT)
        growth = arms.drift_mm * coldness(arms, moment.time_s)[:, None, None, None]
        yield Term("drift", _of_side(side, _columns(growth * places["links"][..., :3])), CONSTANT)
        turns = places["links"][..., 5]  # of each joint about its axis, (views, joints, 6)

        def by_joint(angles: Floats, turns: Floats = turns) -> Floats:
            return np.swapaxes(turns * angles[..., None], 1, 2)

        torques = chain.gravity_torques(moment.joints)
        windup = arms.windup_spread * mean_compliance(arms, chain) * torques
        yield Term("windup", _of_side(side, by_joint(windup)), CONSTANT)
        periods = arms.gear_periods * moment.joints
        for wave in (np.cos(periods), np.sin(periods)):
            gear = np.radians(arms.gear_deg) / np.sqrt(2) * wave
            yield Term("gear", _of_side(side, by_joint(gear)), CONSTANT)
        # Quantisation leaves an error that is uniform over one encoder step.
        step = np.radians(section.encoder_step_deg) / np.sqrt(12)
        step = np.broadcast_to(step, moment.joints.shape)
        yield Term("encoder", _of_side(side, by_joint(step)), 0.0)
        jitter = arms.trigger_jitter_ms * S_PER_MS * moment.speeds
        missed[:, 6 * side : 6 * side + 6, 0] = by_joint(jitter).sum(axis=2)
    yield Term("trigger", missed, 0.0)


def _means(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    """Yield the effects of the mean wind-up of all gears and the mean delay of the triggers."""
    wound, late = np.zeros((2, len(scan.time_s), 12, 1))
    for side, (chain, moment) in enumerate(zip(scan.chains, scan.moments, strict=True)):
        frames = chain.frames(moment.joints)[:, :-1]
        turns = _carried(frames, scan.poses[side][:, None])[..., 5]
        angles = mean_compliance(section.arms, chain) * chain.gravity_torques(moment.joints)
        way = section.arms.trigger_delay_ms * S_PER_MS * moment.speeds
        rows = slice(6 * side, 6 * side + 6)
        wound[:, rows, 0] = np.einsum("vji,vj->vi", turns, angles)
        late[:, rows, 0] = np.einsum("vji,vj->vi", turns, way)
    yield Term("windup, mean", wound, CONSTANT)
    yield Term("trigger, mean", late, CONSTANT)


def _about_z(angles: Floats) -> Floats:
    twists = np.zeros((*angles.shape, 6))
    twists[..., 5] = angles
    return twists


def _columns(factor: Floats) -> Floats:
    """Reshape (views, frames, 6, draws) to (views, 6, frames x draws), without zero columns."""
    flat = np.moveaxis(factor, 1, 2).reshape(len(factor), 6, -1)
    return flat[:, :, flat.any(axis=(0, 1))]


def _of_views(section: Uncertainty, scan: NominalScan) -> Iterator[Term]:
    for side, sigma in enumerate(view_sigmas(section.views)):
        tools = scan.poses[side]
        factor = _carried(tools, tools) * sigma
        yield Term("views", _of_side(side, factor), section.views.correlation_views)
    patient = section.patient
    sizes = amplitudes(patient, scan.time_s)  # a random direction has a mean square of 1/3 per axis
    pivot = np.eye(4)
    pivot[:3, 3] = patient.pivot_mm
    both = np.concatenate(
        [_carried(np.broadcast_to(pivot, t.shape), t) for t in scan.poses], axis=1
    )
    for part in range(4):
        axes = slice(0, 3) if part % 2 == 0 else slice(3, 6)
        factor = -both[:, :, axes] * sizes[:, part, None, None] / np.sqrt(3)
        yield Term("patient", factor, CONSTANT)


def _reported(section: Uncertainty) -> Iterator[Term]:
    for side, noise in enumerate((section.source, section.detector)):
        sigma = np.array([_cut_sigma(noise)] * 3 + [np.radians(noise.rotation_sigma_deg)] * 3)
        yield Term("reported", _of_side(side, np.diag(sigma)[None]), noise.correlation_views)


def _cut_sigma(noise: PoseNoise) -> float:
    """Return the standard deviation of an axis after redraws beyond the cut-off."""
    if noise.cutoff_mm is None or not noise.sigma_mm:
        return noise.sigma_mm
    # Imported here because the import takes half a second.
    from scipy.stats import truncnorm

    cut = noise.cutoff_mm / noise.sigma_mm
    return noise.sigma_mm * float(truncnorm(-cut, cut).std())


@dataclass(frozen=True, eq=False)
class Draws:
    """Random draws of the errors.

    Attributes:
        errors: (draws, views, 12), mm and rad, as defined above.
        true: executed poses relative to the specimen, (2, draws, views, 4, 4), mm.
        believed: believed poses, (2, draws, views, 4, 4), mm.
    """

    errors: Floats
    true: Floats
    believed: Floats


Told = Callable[[int, Floats], Floats]
"""Pose of a tool that the controllers believe, ``world_from_tool``, from side and encoders."""


def draw(
    section: Uncertainty,
    scan: NominalScan,
    draws: int,
    seed: int,
    arms_seed: int,
    told_by: Told | None = None,
) -> Iterator[tuple[slice, Draws]]:
    """Draw a scenario's errors in chunks of views.

    In the first draw, errors that are constant over a scan match a scan with these seeds.

    Args:
        section: sizes of the errors.
        scan: views.
        draws: number of scans.
        seed: seed of errors that change from view to view.
        arms_seed: seed of errors that are constant over a scan.
        told_by: calibrated model of the pair of arms with this seed, which then makes all scans.
            None: each scan has other arms, which the controllers believe to be nominal.

    Yields:
        a slice of views, and their draws.
    """
    views = len(scan.time_s)
    deviations = [
        drawn(section.arms, chain, arms_seed, side, 1 if told_by else draws)
        for chain, side in zip(scan.chains, SIDES, strict=bool(scan.chains))
    ]
    towards = directions(arms_seed, draws)
    jitter = scan_rng(seed, "trigger of all").normal(size=(draws, views))
    own = [
        _alike(seed, f"view {side} of all", draws, views, section.views.correlation_views)
        * sigma.astype(np.float32)
        for side, sigma in zip(SIDES, view_sigmas(section.views), strict=True)
    ]
    told = [
        _reported_draws(noise, seed, side, draws, views)
        for noise, side in zip((section.source, section.detector), SIDES, strict=True)
    ]
    encoders, size = scan_rng(seed, "encoders of all"), max(1, CHUNK // draws)
    for first in range(0, views, size):
        part = slice(first, min(first + size, views))
        late_s = S_PER_MS * (
            section.arms.trigger_delay_ms + section.arms.trigger_jitter_ms * jitter[:, part]
        )
        moved = _patient(section, towards, scan.time_s[part])
        true, believed = [], []
        for side in range(2):
            here = scan.poses[side][None, part]
            known = here
            if deviations:
                known = _encoded(section, scan, side, part, encoders, draws, told_by)
                here = _true(section, scan, side, part, deviations[side], late_s)
            here = here @ exp_matrices(own[side][:, part].astype(float))
            noise = told[side][:, part].astype(float)
            known = known @ exp_matrices(np.concatenate([0 * noise[..., 3:], noise[..., 3:]], -1))
            known[..., :3, 3] += noise[..., :3]
            true.append(here if moved is None else moved @ here)
            believed.append(known)
        yield part, _gathered(np.stack(true), np.stack(believed))


def _gathered(true: Floats, believed: Floats) -> Draws:
    apart = true[..., :3, 3] - believed[..., :3, 3]
    turns = true[..., :3, :3] @ np.swapaxes(believed[..., :3, :3], -1, -2)
    rotations = scipy.spatial.transform.Rotation.from_matrix(turns.reshape(-1, 3, 3))
    angles = rotations.as_rotvec().reshape(apart.shape)
    both = np.concatenate([apart, angles], axis=-1)
    return Draws(np.concatenate([both[0], both[1]], axis=-1), true, believed)


def _true(
    section: Uncertainty,
    scan: NominalScan,
    side: int,
    part: slice,
    deviation: ArmDeviation,
    late_s: Floats,
) -> Floats:
    if not any(section.arms.sizes):
        return scan.poses[side][None, part]
    moment = Moment(*(values[part] for values in scan.moments[side]))
    return true_tools(section.arms, scan.chains[side], deviation, moment, late_s)


def _encoded(
    section: Uncertainty,
    scan: NominalScan,
    side: int,
    part: slice,
    rng: np.random.Generator,
    draws: int,
    told_by: Told | None,
) -> Floats:
    """Return the poses that a model computes from encoders with random errors within a step."""
    joints = scan.moments[side].joints[part][None]
    if step := np.radians(section.encoder_step_deg):
        joints = joints + step * rng.uniform(-0.5, 0.5, (draws, *joints.shape[1:]))
    elif told_by is None:
        return scan.poses[side][None, part]
    return scan.chains[side].tools(joints) if told_by is None else told_by(side, joints)


def _patient(section: Uncertainty, towards: Floats, time_s: Floats) -> Floats | None:
    """Return ``place_from_moved``, (draws, views, 4, 4), or None if the specimen rests."""
    if not any(section.patient.sizes):
        return None
    pivot = np.eye(4)
    pivot[:3, 3] = section.patient.pivot_mm
    moved = exp_matrices(patient_twists(section.patient, towards, time_s))
    return pivot @ np.linalg.inv(moved) @ np.linalg.inv(pivot)


def _alike(seed: int, purpose: str, draws: int, views: int, length: float) -> Singles:
    """Draw standard normal values with a correlation length, (draws, views, 6), float32."""
    rng, own = scan_rng(seed, purpose), weights(length)
    white = rng.standard_normal((draws, views + len(own) - 1, 6), dtype=np.float32)
    if not length:
        return white
    # Imported here because the import takes half a second.
    from scipy.signal import oaconvolve

    return oaconvolve(white, own[None, :, None].astype(np.float32), mode="valid", axes=1)


def _reported_draws(noise: PoseNoise, seed: int, side: str, draws: int, views: int) -> Singles:
    sigma = np.array([noise.sigma_mm] * 3 + [np.radians(noise.rotation_sigma_deg)] * 3, np.float32)
    found = sigma * _alike(seed, f"reported {side}", draws, views, noise.correlation_views)
    rng = scan_rng(seed, f"reported {side} again")
    cutoff = np.inf if noise.cutoff_mm is None else noise.cutoff_mm
    while (beyond := np.abs(found[..., :3]) > cutoff).any():
        found[..., :3][beyond] = rng.normal(0.0, noise.sigma_mm, int(beyond.sum()))
    return found


def pixel_jacobian(scan: NominalScan, panel: Panel, points: Floats) -> Floats:
    """Return the derivatives of points' images with respect to errors: executed minus believed.

    Args:
        scan: views.
        panel: pixel lattice.
        points: (points, 3), mm.

    Returns:
        (views, points, 2, 12), pixels per mm and rad.
    """
    found = []
    for column in range(12):
        step = np.zeros(6)
        step[column % 6] = STEP
        ends = []
        for sign in (1, -1):
            poses = scan.poses.copy()
            poses[column // 6] = _displaced(poses[column // 6], sign * step)
            ends.append(project(poses[:, None], panel, points)[0])
        found.append((ends[0] - ends[1]) / (2 * STEP))
    return np.stack(found, axis=-1)


def _displaced(poses: Floats, error: Floats) -> Floats:
    found = poses.copy()
    found[..., :3, 3] += error[:3]
    turn = scipy.spatial.transform.Rotation.from_rotvec(error[3:])
    found[..., :3, :3] = turn.as_matrix() @ poses[..., :3, :3]
    return found


def project(poses: Floats, panel: Panel, points: Floats) -> Floats:
    """Project points with many geometries.

    Args:
        poses: source and panel, (2, draws, views, 4, 4), mm.
        panel: pixel lattice.
        points: (points, 3), mm.

    Returns:
        fractional (column, row), (draws, views, points, 2).
    """
    source, detector = poses[0][..., None, :3, 3], poses[1][..., :3, 3][..., None, :]
    u, v, normal = np.moveaxis(poses[1][..., :3, :3], -1, 0)[..., None, :]
    rays = points - source
    to_panel = detector - source
    reach = (to_panel * normal).sum(-1) / (rays * normal).sum(-1)
    offset = reach[..., None] * rays - to_panel
    column, row = (offset * u).sum(-1) / panel.pitch_u, (offset * v).sum(-1) / panel.pitch_v
    return np.stack([column, row], axis=-1) + panel.middle


@dataclass(frozen=True, eq=False)
class Propagation:
    """Effects of a scenario's errors on the geometry of its views.

    Attributes:
        analytic: first-order covariances.
        errors: drawn errors, (draws, views, 12), mm and rad.
        points: points for errors in the image, the isocentre first, (points, 3), mm.
        pixels: distance between the executed and the believed image of a point,
            (draws, views, points), pixels.
        jacobian: derivatives of the images, (views, points, 2, 12), pixels per mm and rad.
    """

    analytic: FirstOrder
    errors: Floats
    points: Floats
    pixels: Singles
    jacobian: Floats

    def shares(self) -> list[dict[str, float | str]]:
        """Return the first-order effect of each cause alone over all views, largest first.

        Values are root mean squares: displacement and rotation of source and panel, and distances
        in the image of the isocentre and of the other points.
        """
        rows: list[dict[str, float | str]] = []
        for term in (*self.analytic.terms, *self.analytic.means):
            rms = np.sqrt((term.factor**2).sum(axis=2).mean(axis=0))
            image = self.jacobian @ term.factor[:, None]
            rows.append(
                {
                    "term": term.name,
                    "source_mm": float(np.linalg.norm(rms[:3])),
                    "source_deg": float(np.degrees(np.linalg.norm(rms[3:6]))),
                    "detector_mm": float(np.linalg.norm(rms[6:9])),
                    "detector_deg": float(np.degrees(np.linalg.norm(rms[9:]))),
                    "isocentre_px": _rms_px(image[:, :1]),
                    "region_px": _rms_px(image[:, 1:]),
                }
            )
        return sorted(rows, key=lambda row: -float(row["region_px"]))


def _rms_px(image: Floats) -> float:
    """Return the RMS distance in the image from shifts per draw, (views, points, 2, draws)."""
    return float(np.sqrt((image**2).sum(axis=(2, 3)).mean())) if image.size else float("nan")


def propagate(
    section: Uncertainty,
    scan: NominalScan,
    panel: Panel,
    points: Sequence[Sequence[float]] | Floats,
    *,
    draws: int,
    seed: int,
    arms_seed: int,
) -> Propagation:
    """Draw a scenario's errors, and compute their first-order covariances.

    Args:
        section: errors of the scenario.
        scan: views of the scenario.
        panel: pixel lattice.
        points: points for errors in the image, the isocentre first, (points, 3), mm.
        draws: number of scans.
        seed: seed of errors that change from view to view.
        arms_seed: seed of errors that are constant over a scan.
    """
    where = np.asarray(points, dtype=np.float64)
    errors = np.zeros((draws, len(scan.time_s), 12))
    pixels = np.zeros((draws, len(scan.time_s), len(where)), np.float32)
    for part, drawn_now in draw(section, scan, draws, seed, arms_seed):
        errors[:, part] = drawn_now.errors
        ends = (project(poses, panel, where) for poses in (drawn_now.true, drawn_now.believed))
        pixels[:, part] = np.linalg.norm(np.subtract(*ends), axis=-1)
    analytic = first_order(section, scan)
    return Propagation(analytic, errors, where, pixels, pixel_jacobian(scan, panel, where))
