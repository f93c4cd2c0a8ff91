"""Kernels: photons of a beam, from the source until they are absorbed or leave."""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from twinct.transport._angles import (
    coefficient,
    compton_shape,
    line_energy,
    place_of,
    scatter_compton,
    scatter_rayleigh,
    turned,
)
from twinct.transport._flight import add_amounts, add_energy, fly, inside, optical_depth, voxel_at
from twinct.transport._random import OPTIONS, draw, stream
from twinct.transport.cross_sections import (
    COMPTON,
    COMPTON_NORM,
    LOWEST_KEV,
    RAYLEIGH,
    TOTAL,
)
from twinct.transport.grid import ALONG_U, PERIOD, TILT_PER_MM, passed

EMITTED, DEPOSITED, ESCAPED, COLLISIONS = range(4)
"""Totals of a batch: three energies in keV, and a number.

Energy that is deposited around the grid counts as escaped.
"""

SINGLE_COMPTON, SINGLE_RAYLEIGH, MULTIPLE = range(3)
"""Images of scatter by order; the last one has fluorescence too."""


POINTS, STEP = 2048, 1 / 1.2207440846057596
"""Points in a voxel at the edge of the field, and the step of their sequence (Roberts, 2018)."""


class Field(NamedTuple):
    """A beam for the kernels, in the frame of the grid's low corner: see ``Beam``.

    ``inside`` turns a direction into (a, b, w): the ray meets the field at a / w of u and b / w of
    v from its centre. ``most`` is the largest factor of the profile.
    """

    source: NDArray[np.float64]
    centre: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    inside: NDArray[np.float64]
    shortest: float
    energies: NDArray[np.float64]
    cumulative: NDArray[np.float64]
    profile: NDArray[np.float64]
    most: float


class Pixels(NamedTuple):
    """A flat panel for the kernels, in the frame of the grid's low corner.

    Attributes:
        corner: outer corner of pixel (0, 0), mm.
        u: unit vector along the columns.
        v: unit vector along the rows.
        pitch: pitches along u and v, mm.
        response: signal of a photon at each energy of the coefficients.
        grid: numbers of a grid before the panel, ``NO_GRID`` without one.
        barriers: attenuation of its spaces and strips at these energies, (2, energies), 1/mm.
    """

    corner: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    pitch: NDArray[np.float64]
    response: NDArray[np.float64]
    grid: NDArray[np.float64]
    barriers: NDArray[np.float64]


@njit(**OPTIONS)
def _factor(field, line, a, b):
    """Return the factor of the profile on a line at ``a`` of u and ``b`` of v from the centre."""
    profile = field.profile
    if profile.size == 0:
        return 1.0
    _, rows, columns = profile.shape
    x, y = (a + 1.0) / 2.0 * (columns - 1), (b + 1.0) / 2.0 * (rows - 1)
    i = min(max(int(x), 0), columns - 2)
    j = min(max(int(y), 0), rows - 2)
    x, y = x - i, y - j
    low = profile[line, j, i] + x * (profile[line, j, i + 1] - profile[line, j, i])
    high = profile[line, j + 1, i] + x * (profile[line, j + 1, i + 1] - profile[line, j + 1, i])
    return low + y * (high - low)


@njit(**OPTIONS)
def _emitted(state, field):
    """Return state, direction and energy of a photon at the source."""
    line = 0
    while True:
        state, a = draw(state)
        state, b = draw(state)
        a, b = 2.0 * a - 1.0, 2.0 * b - 1.0
        x = field.centre[0] + a * field.u[0] + b * field.v[0] - field.source[0]
        y = field.centre[1] + a * field.u[1] + b * field.v[1] - field.source[1]
        z = field.centre[2] + a * field.u[2] + b * field.v[2] - field.source[2]
        r = math.sqrt(x * x + y * y + z * z)
        state, u = draw(state)
        # An area of the plane spans a solid angle that falls with the cube of the distance.
        if u >= (field.shortest / r) ** 3:
            continue
        state, u = draw(state)
        line = np.searchsorted(field.cumulative, u, "right")
        if field.profile.size == 0:
            break
        state, u = draw(state)
        if u * field.most < _factor(field, line, a, b):
            break
    return state, x / r, y / r, z / r, field.energies[line]


@njit(**OPTIONS)
def _normal(pixels):
    """Return u x v, which points towards the source."""
    u, v = pixels.u, pixels.v
    return (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )


@njit(**OPTIONS)
def _signal(pixels, shape, a, b, direction, facing, index, fraction):
    """Return the signal of a photon that flies to a place on the panel, behind the grid.

    ``a`` and ``b`` are its column and row, with fractions, ``shape`` is that of the image.
    """
    low = pixels.response[index]
    signal = low + fraction * (pixels.response[index + 1] - low)
    grid = pixels.grid
    if grid[PERIOD] == 0.0:
        return signal
    dx, dy, dz = direction
    along_u = (dx * pixels.u[0] + dy * pixels.u[1] + dz * pixels.u[2]) / facing
    along_v = (dx * pixels.v[0] + dy * pixels.v[1] + dz * pixels.v[2]) / facing
    if grid[ALONG_U] > 0.0:
        across = along_v - (b - shape[0] / 2) * pixels.pitch[1] * grid[TILT_PER_MM]
    else:
        across = along_u - (a - shape[1] / 2) * pixels.pitch[0] * grid[TILT_PER_MM]
    low = pixels.barriers[0, index]
    space = low + fraction * (pixels.barriers[0, index + 1] - low)
    low = pixels.barriers[1, index]
    strip = low + fraction * (pixels.barriers[1, index + 1] - low)
    return signal * passed(grid, space, strip, across, 1.0 / facing)


@njit(**OPTIONS)
def _expect_compton(state, x, y, z, dx, dy, dz, energy, medium, voxels, media, pixels, image):
    """Add what a Compton collision sends to a random point of the panel, on average."""
    rows, columns = image.shape
    state, a = draw(state)
    state, b = draw(state)
    column, row = min(int(a * columns), columns - 1), min(int(b * rows), rows - 1)
    a, b = a * columns, b * rows
    along_u, along_v = a * pixels.pitch[0], b * pixels.pitch[1]
    tx = pixels.corner[0] + along_u * pixels.u[0] + along_v * pixels.v[0] - x
    ty = pixels.corner[1] + along_u * pixels.u[1] + along_v * pixels.v[1] - y
    tz = pixels.corner[2] + along_u * pixels.u[2] + along_v * pixels.v[2] - z
    r = math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / r, ty / r, tz / r
    nx, ny, nz = _normal(pixels)
    facing = -(nx * tx + ny * ty + nz * tz)
    if facing <= 0.0:
        return state
    c = min(max(dx * tx + dy * ty + dz * tz, -1.0), 1.0)
    index, fraction = place_of(energy, len(pixels.response))
    norm = coefficient(media, medium, index, fraction, COMPTON_NORM)
    shape, left = compton_shape(media, medium, energy, c)
    index, fraction = place_of(energy * left, len(pixels.response))
    depth = optical_depth(x, y, z, tx, ty, tz, r, index, fraction, voxels, media)
    area = rows * columns * pixels.pitch[0] * pixels.pitch[1]
    image[row, column] += (
        shape
        / norm
        * area
        * facing
        / (r * r)
        * math.exp(-depth)
        * _signal(pixels, image.shape, a, b, (tx, ty, tz), facing, index, fraction)
    )
    return state


@njit(**OPTIONS)
def _expect_flight(x, y, z, dx, dy, dz, energy, voxels, media, pixels, image):
    """Add what reaches the panel of a photon that flies on without a collision, on average."""
    nx, ny, nz = _normal(pixels)
    facing = -(nx * dx + ny * dy + nz * dz)
    if facing <= 0.0:
        return
    px, py, pz = x - pixels.corner[0], y - pixels.corner[1], z - pixels.corner[2]
    t = (nx * px + ny * py + nz * pz) / facing
    if t <= 0.0:
        return
    px, py, pz = px + t * dx, py + t * dy, pz + t * dz
    a = (px * pixels.u[0] + py * pixels.u[1] + pz * pixels.u[2]) / pixels.pitch[0]
    b = (px * pixels.v[0] + py * pixels.v[1] + pz * pixels.v[2]) / pixels.pitch[1]
    rows, columns = image.shape
    if 0.0 <= a < columns and 0.0 <= b < rows:
        index, fraction = place_of(energy, len(pixels.response))
        depth = optical_depth(x, y, z, dx, dy, dz, t, index, fraction, voxels, media)
        signal = _signal(pixels, image.shape, a, b, (dx, dy, dz), facing, index, fraction)
        image[int(b), int(a)] += math.exp(-depth) * signal


@njit(**OPTIONS)
def _collide(
    state, x, y, z, dx, dy, dz, energy, place, medium, order, voxels, media, pixels, images
):
    """Return state, direction, energy left and order after a collision; add expected signals.

    ``place`` has index, fraction and total coefficient of the energy.
    """
    index, fraction, total = place
    rayleigh = coefficient(media, medium, index, fraction, RAYLEIGH)
    compton = coefficient(media, medium, index, fraction, COMPTON)
    state, u = draw(state)
    u *= total
    if u < rayleigh:
        order = SINGLE_RAYLEIGH if order > MULTIPLE else MULTIPLE
        state, c = scatter_rayleigh(state, media, medium, energy)
        state, dx, dy, dz = turned(state, dx, dy, dz, c)
        if images.size:
            _expect_flight(x, y, z, dx, dy, dz, energy, voxels, media, pixels, images[order])
        return state, dx, dy, dz, energy, order
    if u < rayleigh + compton:
        order = SINGLE_COMPTON if order > MULTIPLE else MULTIPLE
        if images.size:
            image = images[order]
            state = _expect_compton(
                state, x, y, z, dx, dy, dz, energy, medium, voxels, media, pixels, image
            )
        state, c, left = scatter_compton(state, media, medium, energy)
        state, dx, dy, dz = turned(state, dx, dy, dz, c)
        return state, dx, dy, dz, energy * left, order
    line = line_energy(media, medium, index, fraction, u - rayleigh - compton)
    if line > 0.0:
        state, u = draw(state)
        state, dx, dy, dz = turned(state, 0.0, 0.0, 1.0, 2.0 * u - 1.0)
        if images.size:
            image = images[MULTIPLE]
            _expect_flight(x, y, z, dx, dy, dz, line, voxels, media, pixels, image)
    return state, dx, dy, dz, line, MULTIPLE


@njit(**OPTIONS)
def _follow(state, field, voxels, media, pixels, deposits, rows, ways, images, totals):
    """Follow one photon; add its deposits, its expected signals and its totals."""
    length = media.coefficients.shape[1]
    state, dx, dy, dz, energy = _emitted(state, field)
    x, y, z = field.source[0], field.source[1], field.source[2]
    totals[EMITTED] += energy
    order = MULTIPLE + 1
    expected, unscattered = ways
    while energy > 0.0:
        index, fraction = place_of(energy, length)
        scores = rows, deposits, expected and (unscattered or order <= MULTIPLE)
        state, t = fly(state, x, y, z, dx, dy, dz, index, fraction, voxels, media, scores)
        if t < 0.0:
            totals[ESCAPED] += energy
            return
        x, y, z = x + t * dx, y + t * dy, z + t * dz
        here = voxels.around < 0 or inside(x, y, z, voxels)
        voxel = voxel_at(x, y, z, voxels)
        code = voxels.codes[voxel]
        medium = voxels.media[code] if here else voxels.around
        totals[COLLISIONS] += 1.0
        place = index, fraction, coefficient(media, medium, index, fraction, TOTAL)
        state, dx, dy, dz, left, order = _collide(
            state, x, y, z, dx, dy, dz, energy, place, medium, order, voxels, media, pixels, images
        )
        rest = left if left < LOWEST_KEV else 0.0
        given = energy - left + rest
        totals[DEPOSITED if here else ESCAPED] += given
        if here:
            add_energy(rows, deposits, code, voxel, rest if expected else given)
        energy = left - rest


@njit(parallel=True, **OPTIONS)
def follow(keys, photons, field, voxels, media, pixels, deposits, rows, ways, images, totals):
    """Follow the photons of some batches, each of them in one thread.

    Args:
        keys: key of each batch, (batches,), uint64.
        photons: number of photons of a batch.
        field: the beam.
        voxels: the body.
        media: tables of its media.
        pixels: the panel, if images are wanted.
        deposits: energy of each batch and voxel, (batches, z, y, x), keV; added to. Without
            elements, none is scored.
        rows: energy of each batch and row of the palette, (batches, rows), keV; added to.
        ways: whether to add mean energies along the flights, not what collisions happen to
            deposit; and whether flights before the first collision add theirs.
        images: signal of each batch by order, (batches, 3, rows, columns); added to. Without
            elements, none is scored.
        totals: totals of each batch, (batches, 4); added to.
    """
    for batch in prange(len(keys)):
        for photon in range(photons):
            _follow(
                stream(keys[batch], photon),
                field,
                voxels,
                media,
                pixels,
                deposits[batch],
                rows[batch],
                ways,
                images[batch],
                totals[batch],
            )


@njit(**OPTIONS)
def _on_field(inside, dx, dy, dz):
    """Return the place of the field that is nearest to a ray: shares of u and v, -1 to 1."""
    a = inside[0, 0] * dx + inside[0, 1] * dy + inside[0, 2] * dz
    b = inside[1, 0] * dx + inside[1, 1] * dy + inside[1, 2] * dz
    w = inside[2, 0] * dx + inside[2, 1] * dy + inside[2, 2] * dz
    return min(max(a / w, -1.0), 1.0), min(max(b / w, -1.0), 1.0)


@njit(**OPTIONS)
def _in_field(inside, dx, dy, dz):
    """Return whether a direction from the source meets the field, and at what of u and v."""
    a = inside[0, 0] * dx + inside[0, 1] * dy + inside[0, 2] * dz
    b = inside[1, 0] * dx + inside[1, 1] * dy + inside[1, 2] * dz
    w = inside[2, 0] * dx + inside[2, 1] * dy + inside[2, 2] * dz
    if w > 0.0 and abs(a) <= w and abs(b) <= w:
        return True, a / w, b / w
    return False, 0.0, 0.0


@njit(parallel=True, **OPTIONS)
def primary(field, weights, attenuation, voxels, pixels, samples, image):
    """Write the signal of unscattered photons, by rays to points of each pixel.

    Args:
        field: the beam; its source counts.
        weights: photons of each line per solid angle, (lines,).
        attenuation: mu per density of each medium and line, (media, lines), 1/mm per g/cm^3.
        voxels: the body.
        pixels: the panel.
        samples: rays along each edge of a pixel.
        image: signal, (rows, columns).
    """
    rows, columns = image.shape
    nx, ny, nz = _normal(pixels)
    area = pixels.pitch[0] * pixels.pitch[1] / (samples * samples)
    for row in prange(rows):
        amounts = np.zeros(len(attenuation))
        for column in range(columns):
            value = 0.0
            for sample in range(samples * samples):
                a = column + (sample % samples + 0.5) / samples
                b = row + (sample // samples + 0.5) / samples
                x, y = a * pixels.pitch[0], b * pixels.pitch[1]
                dx = pixels.corner[0] + x * pixels.u[0] + y * pixels.v[0] - field.source[0]
                dy = pixels.corner[1] + x * pixels.u[1] + y * pixels.v[1] - field.source[1]
                dz = pixels.corner[2] + x * pixels.u[2] + y * pixels.v[2] - field.source[2]
                r = math.sqrt(dx * dx + dy * dy + dz * dz)
                dx, dy, dz = dx / r, dy / r, dz / r
                lit, across, up = _in_field(field.inside, dx, dy, dz)
                if not lit:
                    continue
                amounts[:] = 0.0
                add_amounts(
                    field.source[0],
                    field.source[1],
                    field.source[2],
                    dx,
                    dy,
                    dz,
                    r,
                    voxels,
                    amounts,
                )
                facing = -(nx * dx + ny * dy + nz * dz)
                signal = 0.0
                for line in range(len(weights)):
                    depth = 0.0
                    for medium in range(len(amounts)):
                        depth += amounts[medium] * attenuation[medium, line]
                    index, fraction = place_of(field.energies[line], len(pixels.response))
                    signal += (
                        weights[line]
                        * _factor(field, line, across, up)
                        * math.exp(-depth)
                        * _signal(pixels, image.shape, a, b, (dx, dy, dz), facing, index, fraction)
                    )
                value += signal * facing * area / (r * r)
            image[row, column] = value


@njit(**OPTIONS)
def _share_in_field(inside, dx, dy, dz, ex, ey, ez):
    """Return the share of a box in the field; its middle is at (dx, dy, dz) from the source."""
    whole = True
    for axis in range(2):
        for sign in (-1.0, 1.0):
            # Positive on the inner side of one of the field's four faces, and linear in place.
            a = inside[2, 0] + sign * inside[axis, 0]
            b = inside[2, 1] + sign * inside[axis, 1]
            c = inside[2, 2] + sign * inside[axis, 2]
            middle = a * dx + b * dy + c * dz
            reach = (abs(a) * ex + abs(b) * ey + abs(c) * ez) / 2.0
            if middle + reach <= 0.0:
                return 0.0
            whole = whole and middle >= reach
    if whole:
        return 1.0
    found = 0
    u = v = w = 0.5
    for _ in range(POINTS):
        # Additive sequence with powers of the root of x^4 = x + 1: evenly spread on each axis.
        u, v, w = (u + STEP) % 1.0, (v + STEP**2) % 1.0, (w + STEP**3) % 1.0
        x, y, z = dx + (u - 0.5) * ex, dy + (v - 0.5) * ey, dz + (w - 0.5) * ez
        lit, _, _ = _in_field(inside, x, y, z)
        found += lit
    return found / POINTS


@njit(parallel=True, **OPTIONS)
def primary_energy(field, weights, attenuation, transfer, voxels, cells, energies):
    """Write the energy that unscattered photons give to electrons, by a ray through each voxel.

    The ray goes through the middle; their number is averaged along its chord. A voxel at the edge
    of the field counts by the share of its volume that lies in it.

    Args:
        field: the beam.
        weights: photons of each line per solid angle, (lines,).
        attenuation: mu per density of each medium and line, (media, lines), 1/mm per g/cm^3.
        transfer: energy given to electrons, (media, lines), keV/mm per g/cm^3.
        voxels: the body.
        cells: places of the voxels in the flattened grid.
        energies: energy of each of them, keV.
    """
    _, ny, nx = voxels.codes.shape
    ex, ey, ez = voxels.edges
    for n in prange(len(cells)):
        k, j, i = cells[n] // (ny * nx), cells[n] // nx % ny, cells[n] % nx
        dx = (i + 0.5) * ex - field.source[0]
        dy = (j + 0.5) * ey - field.source[1]
        dz = (k + 0.5) * ez - field.source[2]
        share = _share_in_field(field.inside, dx, dy, dz, ex, ey, ez)
        if share == 0.0:
            continue
        across, up = _on_field(field.inside, dx, dy, dz)
        r = math.sqrt(dx * dx + dy * dy + dz * dz)
        amounts = np.zeros(len(attenuation))
        x, y, z = field.source
        add_amounts(x, y, z, dx / r, dy / r, dz / r, r, voxels, amounts)
        code = voxels.codes[k, j, i]
        own, density = voxels.media[code], voxels.densities[code]
        chord = r / max(abs(dx) / ex, abs(dy) / ey, abs(dz) / ez)
        energy = 0.0
        for line in range(len(weights)):
            depth = 0.0
            for medium in range(len(amounts)):
                depth += amounts[medium] * attenuation[medium, line]
            x = chord * density * attenuation[own, line]
            mean = -math.expm1(-x) / x if x > 0.0 else 1.0
            photons = weights[line] * _factor(field, line, across, up)
            # The depth is that of the middle; half of the voxel may absorb all of a soft line.
            energy += photons * math.exp(x / 2 - depth) * mean * transfer[own, line]
        energies[n] = share * energy * density * ex * ey * ez / (r * r)
