"""FDK: filtered back projection of circular cone-beam scans.

Circle, axis and spacing are estimated from the views (``orbit``). The back projection uses each
view's own geometry, so that small deviations only affect the direction of the filter. A scan that
deviates from a circle by more than the bounds in ``orbit`` is refused. An arc must cover 180
degrees and the fan; its rays are weighted after Parker (1982), and in a longer arc the angle beyond
180 degrees replaces the fan angle. Each view is weighted by its arc; views of an overlapping turn
share theirs. In a full turn the panel may be shifted sideways (``shifted_panel``).

Rows that do not end at zero, as of a truncated specimen, are extended to zero by half a cosine over
half the panel's width before they are filtered. A view adds nothing to voxels that project beside
its panel. Values fall with the distance from the circle's plane: a circle does not measure all
data.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Literal, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.core.threads import threads
from twinct.geometry import Floats, ScanGeometry
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, solve_by
from twinct.recon.checks import Checks, Mask, mask_of, masked_image
from twinct.recon.engine import Singles
from twinct.recon.orbit import CircularOrbit, fit_circle
from twinct.recon.prepared import Prepared
from twinct.recon.projector import Projector
from twinct.recon.shared_keys import Nonnegative
from twinct.recon.shifted_panel import ShiftedPanel, require_centred, shifted_panel
from twinct.recon.steps import Callback
from twinct.recon.volume import Volume
from twinct.recon.working import WorkingVolume

Window = Literal["ramp", "shepp_logan", "cosine", "hamming", "hann"]

BLOCK = 16
"""Number of views that are filtered and back-projected at a time."""


class Fdk(AlgorithmSettings):
    """Filtered back projection of circular scans."""

    algorithm: Literal["fdk"] = "fdk"
    window: Window = Field(
        default="ramp", description="Window of the ramp filter, from sharp to smooth."
    )
    nonnegative: Nonnegative = False


def fdk(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    window: Window = "ramp",
    nonnegative: bool = False,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a circular scan, a whole turn or a short scan (Feldkamp, Davis, Kress 1984).

    In a whole turn the panel may be shifted; there is no ``x0`` and there are no ``iterations``.

    Peak memory: 1 volume and some images, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        window: window of the ramp filter: ``ramp`` (none), ``shepp_logan``, ``cosine``, ``hamming``
            or ``hann``, from sharp to smooth.
        nonnegative: clip the result at zero.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool. Other
            pixels are interpolated along their row (rows without counting pixels from the rows
            beside them), since the filter needs every pixel: this invents data, while the iterative
            algorithms leave the rays out.
        callback: called after each ``BLOCK`` of views, with NaN for the residual and an unfinished
            volume. True stops.

    Returns:
        The volume; its extras hold the estimated ``circle``, and ``shifted_panel``, None for a
        panel whose middle sees the axis.

    Raises:
        InputError: the scan is no circle, the arc is too short, or as in ``sart``.
    """
    scan = Prepared(FDK, A, line_integrals, mask)
    p, pixels = scan.p, scan.pixels
    circle, shift = _checked_circle(scan, A.geometry, window, pixels)
    blocks = range(0, len(A), BLOCK)
    x, listener = scan.begin(callback, len(blocks))
    sod = A.geometry.depth(circle.centre)
    weights = _weights(A.geometry, circle, sod, shift)
    wide = A if shift is None else A.on(A.grid, shift.extended(A.geometry))
    response = _response(wide.geometry.panel.columns, window)
    work = WorkingVolume(A.kernels, x)
    for block, first in enumerate(blocks):
        views = range(first, min(first + BLOCK, len(A)))
        part = wide[views.start : views.stop]
        images = np.empty((len(views), *wide.range_shape[1:]), np.float32)
        for view, image in zip(views, images, strict=True):
            weighted = _complete(masked_image(p, view, pixels), pixels, view) * weights(view)
            image[:] = _filtered(weighted if shift is None else shift.padded(weighted), response)
        part.back_project(images, sod[views] ** 2, work.held)
        work.changed()
        if listener(0, block, math.nan, 1, work):
            break
    if nonnegative:
        np.maximum(work.array, 0.0, out=work.array)
    return Volume(work.array, A.grid, {"circle": circle, "shifted_panel": shift})


def _checked_circle(
    checks: Checks, geometry: ScanGeometry, window: str, mask: Mask | None
) -> tuple[CircularOrbit, ShiftedPanel | None]:
    """Return circle and shift of the scan; without a circle, raise InputError for all problems."""
    if window not in get_args(Window):
        checks.problems.append(
            f"window is {quoted(window)}; choose from {', '.join(get_args(Window))}"
        )
    if mask is not None and mask.ndim == 3 and not mask.any(axis=(1, 2)).all():
        view = int(mask.any(axis=(1, 2)).argmin())
        checks.problems.append(
            f"the mask leaves no pixel of view {view}; fdk needs pixels of every view"
        )
    try:
        circle = circular(geometry)
    except InputError as error:
        raise InputError([*checks.problems, *error.problems]) from None
    return circle


def _weights(
    geometry: ScanGeometry, circle: CircularOrbit, sod: Floats, shift: ShiftedPanel | None
) -> Callable[[int], Singles]:
    """Return a function from a view to the weights of its pixels, (rows, columns)."""
    fan, (across, up) = _fan(geometry, circle), _coordinates(geometry, circle)

    def weights(view: int) -> Singles:
        sdd, u, v = geometry.sdd[view], across[view], up[view]
        weight = sdd / np.sqrt(sdd**2 + u**2 + v[:, None] ** 2)
        weight *= shift.shares(fan[view]) if shift else _redundancy(circle, view, fan[view])
        # The filter's unit is the pixel; at the axis a pixel is pitch * SOD / SDD wide.
        weight *= circle.steps[view] * sdd / (sod[view] * geometry.panel.pitch_u)
        return weight.astype(np.float32)

    return weights


def _coordinates(geometry: ScanGeometry, circle: CircularOrbit) -> tuple[Floats, Floats]:
    """Return the distances of columns and rows from the centre's projection, (views, n), mm."""
    panel = geometry.panel
    column, row = geometry.project(circle.centre)[:, 0].T
    across = (np.arange(panel.columns) - column[:, None]) * panel.pitch_u
    return across, (np.arange(panel.rows) - row[:, None]) * panel.pitch_v


def _fan(geometry: ScanGeometry, circle: CircularOrbit) -> Floats:
    """Return the fan angle of each column, (views, columns), rad, right-handed about the axis."""
    ahead = np.cross(circle.axis, geometry.source - circle.centre)
    sign = -np.sign(np.einsum("vk,vk->v", geometry.u, ahead))
    return np.arctan(sign[:, None] * _coordinates(geometry, circle)[0] / geometry.sdd[:, None])


def circular(geometry: ScanGeometry) -> tuple[CircularOrbit, ShiftedPanel | None]:
    """Return the circle of a scan and the shift of its panel, unless fdk cannot reconstruct it.

    Raises:
        InputError: the scan deviates from a circle by more than the bounds, or its arc is too
            short, also for a shifted panel.
    """
    circle = fit_circle(geometry)
    fan = _fan(geometry, circle)
    if circle.full:
        return circle, shifted_panel(geometry, circle.centre, fan)
    require_centred(geometry, circle.centre)
    needed = math.pi + 2 * float(np.abs(fan).max())
    # Where the arc of a view ends is known to half of it: half a turn of a source far away is one.
    if circle.span < needed - float(circle.steps.min()) / 2 - 1e-9:
        raise InputError(
            f"the arc covers {math.degrees(circle.span):.4g} deg; fdk needs 180 deg plus the fan "
            f"angle, {math.degrees(needed):.4g} deg, or a full turn; sart and fast take any arc"
        )
    return circle, None


def _redundancy(circle: CircularOrbit, view: int, fan: Floats) -> Floats | float:
    """Return the share of each ray among all rays along its line, (columns,); shares add up to 1.

    A ray at angle b of the source, at g from the central ray, recurs at b + pi + 2 g with -g.
    """
    if circle.full:
        return 0.5
    beyond = (circle.span - math.pi) / 2
    b = circle.angles[view] + circle.steps[0] / 2
    start, end = np.maximum(beyond - fan, 1e-9), np.maximum(beyond + fan, 1e-9)
    rising = np.clip(b / start, 0, 2)
    falling = np.clip((circle.span - b) / end, 0, 2)
    return np.sin(math.pi / 4 * np.minimum(rising, falling)) ** 2


def _response(columns: int, window: str) -> Singles:
    """Return the ramp filter for pixels of width 1, at the frequencies of a padded row.

    It is the transform of the band-limited kernel (Ramachandran, Lakshminarayanan 1971) rather than
    |f| itself: sampling |f| would lower the mean of the image.
    """
    size = _padded(columns)
    n = np.concatenate([np.arange(size // 2 + 1), np.arange(size // 2 + 1 - size, 0)])
    kernel = np.zeros(size)
    kernel[0] = 0.25
    odd = n % 2 == 1
    kernel[odd] = -1 / (math.pi * n[odd]) ** 2
    f: Floats = scipy.fft.rfftfreq(size)
    shapes = {
        "ramp": np.ones_like(f),
        "shepp_logan": np.sinc(f),
        "cosine": np.cos(math.pi * f),
        "hamming": 0.54 + 0.46 * np.cos(2 * math.pi * f),
        "hann": 0.5 + 0.5 * np.cos(2 * math.pi * f),
    }
    return np.multiply(scipy.fft.rfft(kernel).real, shapes[window]).astype(np.float32)


def _padded(columns: int) -> int:
    """Return the length at which the two extended ends of a row do not overlap."""
    return int(scipy.fft.next_fast_len(4 * columns, real=True))


def _filtered(image: Singles, response: Singles) -> Singles:
    """Extend the rows to zero at both ends, filter them, and crop them again."""
    columns = image.shape[1]
    reach = columns // 2
    angle = math.pi * np.arange(1.0, reach + 1) / (reach + 1)
    fade = (0.5 + 0.5 * np.cos(angle)).astype(np.float32)
    padded = np.concatenate([image[:, :1] * fade[::-1], image, image[:, -1:] * fade], axis=1)
    size = _padded(columns)
    spectrum = scipy.fft.rfft(padded, n=size, axis=1, workers=threads())
    spectrum *= response
    rows = scipy.fft.irfft(spectrum, n=size, axis=1, workers=threads())
    return rows[:, reach : reach + columns]


def _complete(image: Singles, mask: Mask | None, view: int) -> Singles:
    """Interpolate masked pixels along their row, and whole rows from the rows beside them."""
    if mask is None:
        return image
    good = mask_of(mask, view)
    columns = np.arange(float(image.shape[1]))
    some = np.flatnonzero(good.any(axis=1))
    for row in some:
        if not good[row].all():
            image[row] = np.interp(columns, columns[good[row]], image[row, good[row]])
    if len(some) < len(image):
        for column in range(image.shape[1]):
            image[:, column] = np.interp(np.arange(len(image)), some, image[some, column])
    return image


FDK = Algorithm(
    Fdk,
    partial(solve_by, fdk),
    volumes=1,
    updates=lambda _, n: -(-n // BLOCK),
    check=lambda own, views, grid: circular(views),
)
