"""What few views leave unknown: the posterior variance of a linear model on a coarse grid.

Attenuation is taken as x ~ N(mean, S), line integrals as p = A x + noise of variance 1 / w, w being
the photons that are expected. Whatever the data will be, what is then known of x has covariance

    C = (S^-1 + A^T diag(w) A)^-1

(A. Tarantola, Inverse Problem Theory, SIAM 2005, section 3.2), and the mean of its diagonal over a
region is the mean square error of the best estimate: to make it small is Bayesian A-optimal design
(K. Chaloner, I. Verdinelli, Statist. Sci. 10 (1995) 273).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.geometry import Floats, VolumeGrid
from twinct.recon import Projector

MOST_VOXELS = 5000
"""Of a coarse grid: its covariance takes 200 MB."""


def prior_covariance(grid: VolumeGrid, deviation: float, correlation_mm: float) -> Floats:
    """S: voxels of one standard deviation, correlated by exp(-distance / length).

    Args:
        grid: n voxels.
        deviation: standard deviation of a voxel before any view, 1/mm.
        correlation_mm: distance at which the correlation is 1 / e.

    Returns:
        (n, n), 1/mm^2, voxels in C order of (z, y, x).

    Raises:
        InputError: a deviation or a length that is not positive, or too many voxels.
    """
    for name, value in (("deviation", deviation), ("correlation_mm", correlation_mm)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}: {value:g}: it must be positive")
    _require_coarse(grid)
    x, y, z = grid.axes()
    places = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1).reshape(-1, 3)
    apart = scipy.spatial.distance.squareform(scipy.spatial.distance.pdist(places))
    return deviation**2 * np.exp(-apart / correlation_mm)


@dataclass(frozen=True, eq=False)
class KnownShare:
    """Share of a region's variance that views take away: 0 with none, 1 if they tell everything.

    Attributes:
        rays: sqrt(w) A of each candidate view at unit exposure, (views, rays, n), float32.
        root: L of S = L L^T, (n, n), 1/mm.
        region: the voxels that are asked for, (n,).
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
        """Of all candidate views.

        Args:
            A: on the coarse grid, best with a panel that is as coarse.
            photons: w at unit exposure, (views, rows, columns).
            covariance: S, (n, n), 1/mm^2.
            region: (z, y, x), True where it counts.

        Raises:
            InputError: too many voxels, shapes that do not fit, an empty region, photons below 0,
                or no covariance.
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
                raise InputError(f"{name} of shape {shape}: {needed} needed")
        if not inside.any():
            raise InputError("the region holds no voxel of the coarse grid")
        if not (np.isfinite(w).all() and (w >= 0).all()):
            raise InputError("photons must be 0 or more")
        try:
            root = scipy.linalg.cholesky(s, lower=True)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(f"covariance: not positive definite: {error}") from error
        rays = np.empty((len(A), w[0].size, n), np.float32)
        voxel = np.zeros(n, np.float32)
        for j in range(n):
            voxel[j] = 1.0
            rays[:, :, j] = A(voxel.reshape(A.domain_shape)).reshape(len(A), -1)
            voxel[j] = 0.0
        rays *= np.sqrt(w).reshape(len(A), -1, 1).astype(np.float32)
        return cls(rays, root, inside.ravel())

    def __call__(self, exposures: ArrayLike) -> float:
        """With an exposure of each view, (views,), 0 where a view is not taken."""
        return 1.0 - float((self._factor(exposures)[:, self.region] ** 2).sum()) / self._before

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """Of a choice of views at unit exposure with one more, for each candidate, (candidates,).

        A view with rays a takes C a^T (a C a^T + 1)^-1 a C away from what is left, C.
        """
        exposures = np.bincount(np.asarray(chosen, np.int64), minlength=len(self.rays))
        factor = self._factor(exposures)
        left = float((factor[:, self.region] ** 2).sum())
        found = np.empty(len(candidates))
        for place, view in enumerate(candidates):
            seen = self.rays[view] @ factor.T
            within = scipy.linalg.cholesky(seen @ seen.T + np.eye(len(seen)), lower=True)
            taken = scipy.linalg.solve_triangular(within, seen @ factor[:, self.region], lower=True)
            found[place] = 1.0 - (left - float((taken**2).sum())) / self._before
        return found

    def slopes(self, exposures: ArrayLike) -> Floats:
        """Derivatives with each view's exposure, (views,): |a C|^2 over the region, of its rays."""
        factor = self._factor(exposures)
        towards = factor.T @ factor[:, self.region]
        return np.array([((one @ towards) ** 2).sum() for one in self.rays]) / self._before

    @property
    def _before(self) -> float:
        """Variance of the region before any view."""
        return float((self.root[self.region] ** 2).sum())

    def _factor(self, exposures: ArrayLike) -> Floats:
        """F of C = F^T F, (n, n): U^-1 L^T, with U U^T = 1 + L^T A^T diag(w) A L."""
        e = np.asarray(exposures, dtype=np.float64)
        if e.shape != (len(self.rays),) or not (np.isfinite(e).all() and (e >= 0).all()):
            raise InputError(f"exposures: one of 0 or more for each of {len(self.rays)} views")
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
            f"the coarse grid has {voxels} voxels: at most {MOST_VOXELS}, such as 17 x 17 x 17"
        )
