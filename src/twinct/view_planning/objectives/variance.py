"""Posterior variance of a linear model on a coarse grid, after a few views.

Attenuation is modelled as x ~ N(mean, S), and line integrals as p = A x + noise of variance 1 / w,
with the expected photons w. For any data, the posterior covariance of x is

    C = (S^-1 + A^T diag(w) A)^-1

(A. Tarantola, Inverse Problem Theory, SIAM 2005, section 3.2). The mean of its diagonal over a
region is the mean square error of the best estimate. Minimising it is Bayesian A-optimal design
(K. Chaloner, I. Verdinelli, Statist. Sci. 10 (1995) 273).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.core.settings import Positive, setting
from twinct.geometry import Floats, VolumeGrid
from twinct.recon import Projector
from twinct.view_planning.objectives.objective import MoreIsBetter, Objective, PatientModel, Views

MOST_VOXELS = 5000
"""Largest number of voxels of a coarse grid, whose covariance takes 200 MB."""


MOST_GB = 2.0
"""Memory limit for the rays of all candidates, GB."""


class KnownGoal(MoreIsBetter):
    """Knowledge of the region from few views, predicted by a linear model: more is better."""

    correlation_mm: Positive = setting(
        20.0, "Distance at which the correlation of attenuations is 1 / e, before any view."
    )
    deviation_rel: Positive = setting(
        0.5,
        "Standard deviation of attenuation before any view, relative to the attenuation of the "
        "reference material.",
        unit="1",
    )
    voxels: int = setting(
        600, "Number of voxels of the coarse grid around the specimen.", ge=8, le=5000
    )


def prior_covariance(grid: VolumeGrid, deviation: float, correlation_mm: float) -> Floats:
    """Compute S for voxels of equal standard deviation, correlated by exp(-distance / length).

    Args:
        grid: n voxels.
        deviation: standard deviation of a voxel before any view, 1/mm.
        correlation_mm: distance at which the correlation is 1 / e.

    Returns:
        (n, n), 1/mm^2, voxels in C order of (z, y, x).

    Raises:
        InputError: deviation or length is not positive, or the grid has too many voxels.
    """
    for name, value in (("deviation", deviation), ("correlation_mm", correlation_mm)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} is {value:g}; it must be positive")
    _require_coarse(grid)
    x, y, z = grid.axes()
    places = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1).reshape(-1, 3)
    apart = scipy.spatial.distance.squareform(scipy.spatial.distance.pdist(places))
    return deviation**2 * np.exp(-apart / correlation_mm)


@dataclass(frozen=True, eq=False)
class KnownShare:
    """Share of a region's variance that views remove: 0 without views, 1 for full knowledge.

    Attributes:
        rays: sqrt(w) A of each candidate view at unit exposure, (views, rays, n), float32.
        root: L of S = L L^T, (n, n), 1/mm.
        region: flags of the voxels of the region, (n,).
    """

    rays: NDArray[np.float32]
    root: Floats
    region: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        A: Projector,  # noqa: N803 - as in A x = p
        photons: ArrayLike,
        covariance: ArrayLike,
        region: ArrayLike,
    ) -> KnownShare:
        """Compute the rays of all candidate views.

        Args:
            A: projector on the coarse grid, preferably with an equally coarse panel.
            photons: w at unit exposure, (views, rows, columns).
            covariance: S, (n, n), 1/mm^2.
            region: (z, y, x), True inside the region.

        Raises:
            InputError: too many voxels, shapes that do not match, an empty region, photons below 0,
                or a covariance that is not positive definite.
        """
        _require_coarse(A.grid)
        n = int(np.prod(A.domain_shape))
        w = np.asarray(photons, dtype=np.float64)
        s, inside = np.asarray(covariance, dtype=np.float64), np.asarray(region, dtype=np.bool_)
        for name, shape, needed in (
            ("photons", w.shape, A.range_shape),
            ("covariance", s.shape, (n, n)),
            ("region", inside.shape, A.domain_shape),
        ):
            if shape != needed:
                raise InputError(f"{name} has shape {shape}; it must be {needed}")
        if not inside.any():
            raise InputError("the region holds no voxel of the coarse grid")
        if not (np.isfinite(w).all() and (w >= 0).all()):
            raise InputError("photons must be 0 or more")
        try:
            root = scipy.linalg.cholesky(s, lower=True)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(f"covariance is not positive definite: {error}") from error
        rays = np.empty((len(A), w[0].size, n), np.float32)
        voxel = np.zeros(n, np.float32)
        for j in range(n):
            voxel[j] = 1.0
            rays[:, :, j] = A(voxel.reshape(A.domain_shape)).reshape(len(A), -1)
            voxel[j] = 0.0
        rays *= np.sqrt(w).reshape(len(A), -1, 1).astype(np.float32)
        return cls(rays, root, inside.ravel())

    def __call__(self, exposures: ArrayLike) -> float:
        """Return the share for exposures of all views, (views,), 0 for a view that is not taken."""
        return 1.0 - float((self._factor(exposures)[:, self.region] ** 2).sum()) / self._before

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """Return the share of a choice with one more view, for each candidate, (candidates,).

        All views have unit exposure. A view with rays a reduces the covariance C by
        C a^T (a C a^T + 1)^-1 a C.
        """
        exposures = np.bincount(np.asarray(chosen, np.int64), minlength=len(self.rays))
        factor = self._factor(exposures)
        left = float((factor[:, self.region] ** 2).sum())
        result = np.empty(len(candidates))
        for place, view in enumerate(candidates):
            seen = self.rays[view] @ factor.T
            within = scipy.linalg.cholesky(seen @ seen.T + np.eye(len(seen)), lower=True)
            taken = scipy.linalg.solve_triangular(within, seen @ factor[:, self.region], lower=True)
            result[place] = 1.0 - (left - float((taken**2).sum())) / self._before
        return result

    def slopes(self, exposures: ArrayLike) -> Floats:
        """Return derivatives by each view's exposure, (views,): |a C|^2 over the region."""
        factor = self._factor(exposures)
        towards = factor.T @ factor[:, self.region]
        return np.array([((one @ towards) ** 2).sum() for one in self.rays]) / self._before

    @property
    def _before(self) -> float:
        """Variance of the region before any view."""
        return float((self.root[self.region] ** 2).sum())

    def _factor(self, exposures: ArrayLike) -> Floats:
        """Return F of C = F^T F, (n, n): U^-1 L^T, with U U^T = 1 + L^T A^T diag(w) A L."""
        e = np.asarray(exposures, dtype=np.float64)
        if e.shape != (len(self.rays),) or not (np.isfinite(e).all() and (e >= 0).all()):
            raise InputError(f"exposures must be 0 or more, one for each of {len(self.rays)} views")
        taken = np.flatnonzero(e)
        known = np.eye(len(self.root))
        for view in taken:
            part = self.rays[view] @ self.root
            known += e[view] * part.T @ part
        factor = scipy.linalg.cholesky(known, lower=True)
        return scipy.linalg.solve_triangular(factor, self.root.T, lower=True)


def _require_coarse(grid: VolumeGrid) -> None:
    voxels = int(np.prod(grid.shape))
    if voxels > MOST_VOXELS:
        raise InputError(
            f"the coarse grid has {voxels} voxels; at most {MOST_VOXELS} are allowed, "
            "such as 17 x 17 x 17"
        )


def _measure(settings: KnownGoal, views: Views, patient: PatientModel) -> KnownShare:
    """Return the share of the region's variance that views remove."""
    place = views.points[0]
    around = patient.attenuation(patient.energy_kev).grid
    edges = around.size_mm
    voxel = float(np.cbrt(edges.prod() / settings.voxels))
    count = np.maximum(np.floor(edges / voxel).astype(int), 1)  # at most the requested number
    grid = VolumeGrid(count[::-1].tolist(), edges / count, around.world_from_grid)
    coarse, photons = patient.photons(views.geometry, place, voxel, "task.known")
    held, number = photons.size * int(count.prod()) * 4 / 1e9, len(views.geometry)
    if held > MOST_GB:
        raise InputError(
            f"task.known.voxels: {settings.voxels} need {held:.1f} GB for {number} views, "
            f"at most {MOST_GB:g} GB are allowed; use fewer voxels or fewer task.candidates"
        )
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    far = np.linalg.norm(grid.world_from_grid.apply(np.stack([x, y, z], -1)) - place, axis=-1)
    region = far <= max(views.radius_mm, float(far.min()))
    deviation = settings.deviation_rel * patient.reference_mu
    covariance = prior_covariance(grid, deviation, settings.correlation_mm)
    return KnownShare.of(Projector(coarse, grid), photons, covariance, region)


KNOWN = Objective("known", KnownGoal, _measure, "Favour knowledge of the region from few views.")
