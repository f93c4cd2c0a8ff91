"""Signs that the model of the rays does not fit the projections: warnings that name the cures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from twinct.diagnosis import diagnosed
from twinct.recon.projector import Projector
from twinct.recon.signs_beyond import signs_beyond
from twinct.recon.unexplained import Unexplained, unexplained
from twinct.recon.volume import Volume
from twinct.runs.cures import cures_of
from twinct.scan import Scan

MUCH_BESIDE = 0.2
"""Share of the attenuation on rays beside the grid from which the user is warned."""

UNEQUAL = 2.0
"""Ratio of the views' mean attenuation in the grid from which the user is warned."""

MUCH_UNEXPLAINED = 0.06
"""Share of the line integrals left unexplained from which the user is warned."""

PART_OF_NOISE = 0.5
"""Share relative to the noise below which there is no warning: the noise is not known better."""

MUCH_FOR_EDGES = 2.0
"""Ratio of this share to what edges usually leave below which there is no warning."""

STILL_FALLS = 0.9
"""Ratio of the last two residuals below which further passes would lower it much."""

DIGITS = 3
"""Decimals of a share."""


def doubt_of_grid(
    A: Projector, integrals: NDArray[np.float32], pixels: NDArray[np.bool_] | None
) -> str | None:
    """Return a warning if the projections show that the object reaches beyond the grid."""
    signs = signs_beyond(A, integrals, pixels)
    if signs.beside <= MUCH_BESIDE and signs.ratio <= UNEQUAL:
        return None
    return (
        f"the object reaches beyond the grid: {100 * signs.beside:.0f} % of its attenuation is on "
        f"rays that miss the grid, and the mean that a view shows in the grid varies by a factor "
        f"of {signs.ratio:.1f}; remove what lies around with "
        "reconstruction.surroundings={margin_mm: ...}, a margin up to the object's end, or use a "
        "larger reconstruction.grid"
    )


def doubt_of_prior(volume: Volume) -> str | None:
    """Return a warning if a prior does not help to predict views that it was not fitted to."""
    ratio = volume.extras.get("prior", {}).get("left_out_ratio")
    if ratio is None or ratio < 1:
        return None
    return (
        "the prior does not help: volumes from four fifths of the views predict the others no "
        f"better with it than without it (residuals {ratio:.3f} times as large); is it of the same "
        "object, and sharp enough? fast works without a prior"
    )


def judged_by_rays(
    volume: Volume,
    A: Projector,
    integrals: NDArray[np.float32],
    scan: Scan,
    pixels: NDArray[np.bool_] | None,
    course: Sequence[float],
) -> tuple[Volume, str | None]:
    """Return a volume with ``unexplained`` in its extras, and a warning if it leaves much.

    Then the extra ``diagnosis`` holds what each cause explains (``twinct.diagnosis``). The extra
    ``predicted`` (see ``Problem.predicted_views``) is taken out.

    Args:
        volume: the volume.
        A: the projector.
        integrals: line integrals that it was made from, (views, rows, columns).
        scan: the images as measured, and the scenario.
        pixels: True where a pixel counts.
        course: residual of each pass; without any, the volume was not fitted to the line
            integrals, and there is no warning.
    """
    extras = dict(volume.extras)
    predicted = extras.pop("predicted", None)
    seen = scan.transmission, pixels, _photons(scan)
    rest = unexplained(A, integrals, volume.array, *seen, predicted)
    if rest is not None:
        extras["unexplained"] = asdict(rest)
    if rest is None or not course or not leaves_much(rest):
        return replace(volume, extras=extras), None
    causes = diagnosed(A, integrals, pixels, seen[2])
    if causes.all:
        extras["diagnosis"] = {one.name: round(one.share, DIGITS) for one in causes.all}
    cures = cures_of(scan, [cause.name for cause in causes.named])
    listed = "; ".join([*cures, *_causes_of_volume(scan, course)])
    return replace(volume, extras=extras), (
        f"the volume does not explain the projections: it leaves {100 * rest.share:.0f} % of the "
        f"line integrals, beyond noise of {100 * rest.noise:.1f} % and {100 * rest.edges:.1f} % "
        f"that edges in such voxels usually leave. Likely causes, with cures: {listed}"
    )


def leaves_much(rest: Unexplained) -> bool:
    """Return whether a volume leaves more than noise and edges usually do."""
    usual = max(MUCH_UNEXPLAINED, PART_OF_NOISE * rest.noise, MUCH_FOR_EDGES * rest.edges)
    return rest.share > usual


def _photons(scan: Scan) -> NDArray[np.float64] | None:
    """Return the photons of a pixel; infinitely many if the images are simulated without noise."""
    return np.full(len(scan), np.inf) if scan.provenance.noiseless else scan.photons


def _causes_of_volume(scan: Scan, course: Sequence[float]) -> list[str]:
    """Return likely causes that lie in the volume and not in the projections."""
    single = getattr(scan.settings.reconstruction, "iterations", 2) == 1
    causes = {
        "too few passes, since the residual still falls (reconstruction.iterations)": len(course)
        > 1
        and course[-1] < STILL_FALLS * course[-2],
        "a single pass (reconstruction.iterations)": single,
        "parts about as thin as a voxel, or thinner (smaller voxels in reconstruction.grid)": True,
    }
    return [cause for cause, likely in causes.items() if likely]
