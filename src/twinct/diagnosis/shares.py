"""Shares of the unexplained residual that causes explain in views which they were not fitted to.

All numbers of a cause are fitted by weighted least squares, on top of what coarse voxels always
leave (``_edges``): to nine tenths of the views, and judged in the tenth, in turn. So a cause with
more numbers gains nothing by chance, and a share of a scan without errors is about zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.diagnosis.cause import Cause
from twinct.diagnosis.coarse import Coarse
from twinct.geometry import Floats
from twinct.recon.engine import Singles

FOLDS, RUNS = 10, 20
"""Parts of the views, and runs of successive views that they are made up of."""

RIDGE = 1e-6
"""Relative addition to the normal matrix: signatures may be alike."""

SCREENED = 1.5
"""Product of a geometric signature and the residual, relative to its standard error, from which a
short reconstruction is spent on the signature."""

LEAST_MODEL = 0.05
"""Least share of the residual's variance that is not noise, in the weights."""


@dataclass(frozen=True)
class Share:
    """Share of a cause in what a volume leaves unexplained.

    Attributes:
        name: name of the cause.
        share: share of the sum of squares; below 0 if the cause explains nothing.
        sigmas: mean share of parts of the views, relative to its standard error.
        explained: root mean square of what it explains, relative to that of the line integrals.
    """

    name: str
    share: float
    sigmas: float
    explained: float


@dataclass(frozen=True, eq=False)
class Residual:
    """The unexplained residual of a scan, and the signatures of causes, as sums over each view.

    Attributes:
        owners: name of each signature's cause; "" for what coarse voxels always leave.
        products: weighted products of signatures, (views, n, n).
        pulls: weighted products of signatures and residual, (views, n).
        squares: weighted squares of the residual, (views,).
        size: root mean square of the residual, relative to that of the line integrals.
        by_view: shares of causes whose numbers belong to single views.
    """

    owners: tuple[str, ...]
    products: Floats
    pulls: Floats
    squares: Floats
    size: float
    by_view: dict[str, Floats]

    @classmethod
    def of(cls, scan: Coarse, causes: Sequence[Cause]) -> Residual:
        """Take the sums of a scan; each signature costs a short reconstruction."""
        rest = scan.unexplained(scan.p)
        root = _root_of_weights(scan, rest)
        views = len(rest)
        size = _rms(rest) / max(_rms(scan.p), 1e-30)
        rest = root * rest
        owners: list[str] = []
        columns: list[Singles] = []
        by_view: dict[str, Floats] = {}
        for cause in (Cause("", _edges), *causes):
            if cause.by_view:
                freedom = [root * one for one in cause.signatures(scan)]
                by_view[cause.name] = _gains_by_view(freedom, rest)
                continue
            for signature in cause.signatures(scan):
                image = np.where(scan.counts, signature, np.float32(0)).astype(np.float32)
                if cause.geometric and _sigmas(_by_view(root * image, rest)) < SCREENED:
                    continue
                columns.append((root * scan.unexplained(image)).reshape(views, -1))
                owners.append(cause.name)
        rest = rest.reshape(views, -1)
        basis = np.stack(columns, axis=1)
        basis /= np.sqrt(np.square(basis).sum(axis=(0, 2), keepdims=True)) + 1e-30
        products = basis @ basis.transpose(0, 2, 1)
        pulls = (basis @ rest[:, :, None])[:, :, 0]
        squares = np.square(rest).sum(axis=1)
        return cls(
            owners=tuple(owners),
            products=np.asarray(products, np.float64),
            pulls=np.asarray(pulls, np.float64),
            squares=np.asarray(squares, np.float64),
            size=size,
            by_view=by_view,
        )

    def share(self, name: str, after: Sequence[str] = ()) -> Share:
        """Return the share of a cause, after some others explained what they can."""
        if name in self.by_view:
            gains, left = self.by_view[name], self.squares
        else:
            before = self._gains(("", *after))
            gains, left = self._gains(("", *after, name)) - before, self.squares - before
        share = float(gains.sum()) / max(float(left.sum()), 1e-30)
        parts = _parts_of(len(gains))
        whole = np.maximum(np.bincount(parts, left, FOLDS), 1e-30)
        each = np.bincount(parts, gains, FOLDS) / whole
        # Roots: a step of the object shows in few parts, which is no reason to doubt it.
        sigmas = math.copysign(_sigmas_of_parts(np.sign(each) * np.sqrt(np.abs(each))), share)
        of_all = max(float(gains.sum()), 0.0) / max(float(self.squares.sum()), 1e-30)
        return Share(name, share, sigmas, self.size * math.sqrt(of_all))

    def _gains(self, names: Sequence[str]) -> Floats:
        """Return how much the causes lower each view's squares, fitted to other views, (views,)."""
        own = np.flatnonzero(np.isin(self.owners, names))
        gains, parts = np.zeros(len(self.squares)), _parts_of(len(self.squares))
        products, pulls = self.products[:, own][:, :, own], self.pulls[:, own]
        for part in range(FOLDS):
            held = parts == part
            normal = products[~held].sum(axis=0) + RIDGE * np.eye(len(own))
            factors = np.linalg.solve(normal, pulls[~held].sum(axis=0))
            gains[held] = 2 * pulls[held] @ factors - factors @ products[held] @ factors
        return gains


def _rms(images: Singles) -> float:
    return math.sqrt(float(np.square(images, dtype=np.float64).mean()))


def _parts_of(views: int) -> NDArray[np.intp]:
    """Return the part that each view belongs to, (views,)."""
    return np.arange(views) * min(RUNS, views) // views % FOLDS


def _sigmas(sums: Floats) -> float:
    """Return how much sums of views are, relative to their standard error, from parts of them."""
    return _sigmas_of_parts(np.bincount(_parts_of(len(sums)), sums, FOLDS).astype(np.float64))


def _sigmas_of_parts(parts: Floats) -> float:
    error = float(parts.std(ddof=1)) / np.sqrt(len(parts))
    return abs(float(parts.mean())) / max(error, 1e-30)


def _by_view(one: Singles, other: Singles) -> Floats:
    """Return the products of images, summed over each view, (views,)."""
    return np.einsum("vrc,vrc->v", one, other, dtype=np.float64)


def _root_of_weights(scan: Coarse, rest: Singles) -> Singles:
    """Return the root of each pixel's weight: one over noise and what a wrong model leaves."""
    rays = max(int(scan.counts.sum()), 1)
    spread = max(float(np.square(rest, dtype=np.float64).sum()) / rays, 1e-30)
    noise = float(scan.variance[scan.counts].sum(dtype=np.float64)) / rays
    model = np.float32(max(spread - noise, LEAST_MODEL * spread))
    return np.sqrt(scan.counts / (scan.variance + model))


def _edges(scan: Coarse) -> Iterator[Singles]:
    """Yield images of what is left where voxels and pixels are coarse, without any error.

    The last one is the variance of line integrals in a pixel, whose mean is of intensities.
    """
    q = scan.predicted
    yield q
    yield np.stack([scipy.ndimage.laplace(image) for image in q])
    yield np.stack([np.square(np.gradient(image)).sum(axis=0) for image in q])


def _gains_by_view(freedom: Sequence[Singles], rest: Singles) -> Floats:
    """Return how much numbers of single views lower their squares, (views,).

    They are fitted to every other row and judged in the rest. A volume of all views absorbs little
    of what a single one shows.
    """
    gains = np.zeros(len(rest))
    for view, image in enumerate(rest):
        for fitted, judged in ((0, 1), (1, 0)):
            one, other = (
                np.stack([f[view, half::2].ravel() for f in freedom]) for half in (fitted, judged)
            )
            normal = one @ one.T
            normal += (1e-3 * np.trace(normal) + 1e-30) / len(normal) * np.eye(len(normal))
            factors = np.linalg.solve(normal, one @ image[fitted::2].ravel())
            gain = factors @ other
            gains[view] += 2 * gain @ image[judged::2].ravel() - gain @ gain
    return gains
