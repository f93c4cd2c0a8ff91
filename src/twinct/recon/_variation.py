"""Kernels of total variation's dual, for both engines of the processor; a card has its own.

All arrays are (z, y, x). With weights q, b = q z, duals p of radius r, and D the forward
differences over the voxel edges, the volume is x = max((b - D^T p) / q, floor). A dual vector is
stored as a share of its radius, in 16 bits, which halves its memory; a step that rounding loses
would change the object's attenuation by 1e-5.

q may be that of voxels twice as large along some axes: its shape says so. Blocks that are not
``filled`` hold zeros (``blocks.Blocks``); if ``filled`` is empty, all are.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit, prange

from twinct.recon.blocks import EDGE

CUBE, DUAL, FILLED = "f4[:, :, ::1]", "i2[:, :, :, ::1]", "u1[:, :, ::1]"
OPTIONS = {"nogil": True, "error_model": "numpy"}
"""Without fast mathematics: LLVM vectorises these loops anyway, and no bit depends on a process."""

WHOLE = np.float32(32767)
"""Stored length of a dual vector as long as its radius."""

SLAB = 16
"""Planes that one thread takes in turn. The first of each slab is kept, a sixteenth of a volume."""


@njit(**OPTIONS)
def _rows(q, k, j, shape):
    """Return the numbers of the line of weights, perhaps of voxels twice as large."""
    return k if len(q) == shape[0] else k // 2, j if q.shape[1] == shape[1] else j // 2


@njit(**OPTIONS)
def _spread(values, cells, out):
    """Write values of voxels, or of voxels twice as large, to a line."""
    n = out.shape[0]
    if cells == n:
        for i in range(n):
            out[i] = values[i]
        return
    for i in range(n // 2):
        out[2 * i] = values[i]
        out[2 * i + 1] = values[i]
    out[n - 1] = values[cells - 1]


@njit(**OPTIONS)
def _holds(filled, k, j):
    """Return True if a line of voxels may hold something."""
    if filled.shape[0] == 0:
        return True
    for block in range(filled.shape[2]):
        if filled[k // EDGE, j // EDGE, block] != 0:
            return True
    return False


# LLVM vectorises loops that write one array and read few: it has to show that none overlaps it.


@njit(**OPTIONS)
def _subtract_turned(dual, n, k, j, scales, out):
    """Subtract D^T p of a line; ``scales`` are those of a stored 1 along x, y, z."""
    zero, (x, y, z) = np.float32(0), scales
    j0, before = max(j - 1, 0), y if j > 0 else zero
    k0, below = max(k - 1, 0), z if k > 0 else zero
    px, py, pz = 3 * n, 3 * n + 1, 3 * n + 2
    out[0] += x * np.float32(dual[px, k, j, 0])
    for i in range(out.shape[0] - 1):
        out[i + 1] += x * (np.float32(dual[px, k, j, i + 1]) - np.float32(dual[px, k, j, i]))
    for i in range(out.shape[0]):
        rise = y * np.float32(dual[py, k, j, i]) - before * np.float32(dual[py, k, j0, i])
        rise += z * np.float32(dual[pz, k, j, i]) - below * np.float32(dual[pz, k0, j, i])
        out[i] += rise


@njit(**OPTIONS)
def _clear(filled, k, j, out):
    """Set the blocks of a line that hold nothing to 0."""
    if filled.shape[0] > 0:
        for block in range(filled.shape[2]):
            if filled[k // EDGE, j // EDGE, block] == 0:
                for i in range(block * EDGE, min((block + 1) * EDGE, out.shape[0])):
                    out[i] = np.float32(0)


@njit(**OPTIONS)
def _line(b, q, dual, radii, inverse, floor, filled, k, j, small, shares, out):
    """Write a line of x; ``small`` and ``shares`` are room for a line each."""
    nx = out.shape[0]
    if not _holds(filled, k, j):
        for i in range(nx):
            out[i] = np.float32(0)
        return
    for i in range(nx):
        out[i] = b[k, j, i]
    for n in range(len(radii)):
        unit = radii[n] / WHOLE
        x, y, z = unit * inverse[0], unit * inverse[1], unit * inverse[2]
        _subtract_turned(dual, n, k, j, (np.float32(x), np.float32(y), np.float32(z)), out)
    qk, qj = _rows(q, k, j, b.shape)
    for i in range(q.shape[2]):
        small[i] = np.float32(1) / q[qk, qj, i]
    _spread(small, q.shape[2], shares)
    for i in range(nx):
        value = out[i] * shares[i]
        out[i] = value if value > floor else floor
    _clear(filled, k, j, out)


@njit(**OPTIONS)
def _least(q, k, j, shape, small, out):
    """Write the smallest weight in the differences of each voxel; ``small`` is room for a line."""
    qk, qj = _rows(q, k, j, shape)
    ahead = _rows(q, k, min(j + 1, shape[1] - 1), shape)[1]
    up = _rows(q, min(k + 1, shape[0] - 1), j, shape)[0]
    cells = q.shape[2]
    for i in range(cells):
        one, other = q[qk, ahead, i], q[up, qj, i]
        small[i] = one if one < other else other
    for i in range(cells - 1):
        one, other = q[qk, qj, i], q[qk, qj, i + 1]
        least = one if one < other else other
        small[i] = least if least < small[i] else small[i]
    last = q[qk, qj, cells - 1]
    small[cells - 1] = last if last < small[cells - 1] else small[cells - 1]
    _spread(small, cells, out)


@njit(**OPTIONS)
def _step(dual, n, k, j, row, beside, above, steps, slopes, ahead, shrinkage):
    """Step along the gradient of a line, then project into the ball; see ``ascend``.

    ``ahead`` and ``shrinkage`` are room for a line each.
    """
    (x, y, z), nx, square = slopes, row.shape[0], WHOLE * WHOLE
    for i in range(nx - 1):
        ahead[i] = row[i + 1] - row[i]
    ahead[nx - 1] = np.float32(0)
    for i in range(nx):
        a = np.float32(dual[3 * n, k, j, i]) + steps[i] * x * ahead[i]
        b = np.float32(dual[3 * n + 1, k, j, i]) + steps[i] * y * (beside[i] - row[i])
        c = np.float32(dual[3 * n + 2, k, j, i]) + steps[i] * z * (above[i] - row[i])
        length = a * a + b * b + c * c
        shrinkage[i] = WHOLE / np.sqrt(length if length > square else square)
    for i in range(nx):
        a = np.float32(dual[3 * n, k, j, i]) + steps[i] * x * ahead[i]
        dual[3 * n, k, j, i] = np.int16(np.rint(a * shrinkage[i]))
    for i in range(nx):
        b = np.float32(dual[3 * n + 1, k, j, i]) + steps[i] * y * (beside[i] - row[i])
        dual[3 * n + 1, k, j, i] = np.int16(np.rint(b * shrinkage[i]))
    for i in range(nx):
        c = np.float32(dual[3 * n + 2, k, j, i]) + steps[i] * z * (above[i] - row[i])
        dual[3 * n + 2, k, j, i] = np.int16(np.rint(c * shrinkage[i]))


@njit(**OPTIONS)
def _clear_seams(dual, n, k, j, seams):
    """Set the vectors of a line at seams to 0."""
    for i in range(seams.shape[2]):
        if seams[k, j, i] != 0:
            for axis in range(3):
                dual[3 * n + axis, k, j, i] = 0


@njit(**OPTIONS)
def _ascend_plane(b, q, dual, radii, known, seams, inverse, step, filled, k, here, above, room):
    """Take the step of one plane, from x there and in the plane above."""
    nz, ny, nx = b.shape
    wx, wy, wz = inverse
    scale = step / (4.0 * max(wx, wy, wz) * (wx + wy + wz)) * WHOLE
    slopes = np.float32(wx), np.float32(wy), np.float32(wz)
    least, steps, ahead, shrinkage, own, beside, top = room
    k1 = min(k + 1, nz - 1)
    for j in range(ny):
        if not _holds(filled, k, j):
            continue
        j1 = min(j + 1, ny - 1)
        _least(q, k, j, b.shape, steps, least)
        for n in range(len(radii)):
            if radii[n] <= 0:
                continue
            factor = np.float32(scale / radii[n])
            for i in range(nx):
                steps[i] = least[i] * factor
            row, side, up = here[j], here[j1], above[j]
            if n == 1:
                for i in range(nx):
                    own[i] = row[i] - known[k, j, i]
                    beside[i] = side[i] - known[k, j1, i]
                    top[i] = up[i] - known[k1, j, i]
                row, side, up = own, beside, top
            _step(dual, n, k, j, row, side, up, steps, slopes, ahead, shrinkage)
            if n == 1:
                _clear_seams(dual, n, k, j, seams)


@njit(
    f"void({CUBE}, {CUBE}, {DUAL}, f8[::1], {CUBE}, {FILLED}, f8[::1], f4, f8, {FILLED})",
    cache=True,
    parallel=True,
    **OPTIONS,
)
def ascend(b, q, dual, radii, known, seams, inverse, floor, step, filled):
    """Take a projected gradient step on the duals, see ``engine``."""
    nz, ny, nx = b.shape
    slabs = (nz + SLAB - 1) // SLAB
    firsts = np.empty((slabs, ny, nx), np.float32)
    for number in prange(slabs):
        slab, one, other = np.int64(number), np.empty(nx, np.float32), np.empty(nx, np.float32)
        for j in range(ny):
            out = firsts[slab, j]
            _line(b, q, dual, radii, inverse, floor, filled, slab * SLAB, j, one, other, out)
    for number in prange(slabs):
        slab, one, other = np.int64(number), np.empty(nx, np.float32), np.empty(nx, np.float32)
        planes, lines = np.empty((2, ny, nx), np.float32), np.empty((5, nx), np.float32)
        room = one, other, lines[0], lines[1], lines[2], lines[3], lines[4]
        begin, end = slab * SLAB, min((slab + 1) * SLAB, nz)
        planes[0] = firsts[slab]
        for k in range(begin, end):
            here, above = planes[(k - begin) % 2], planes[(k - begin + 1) % 2]
            if k + 1 < end:
                for j in range(ny):
                    out = above[j]
                    _line(b, q, dual, radii, inverse, floor, filled, k + 1, j, one, other, out)
            else:
                above[:] = firsts[slab + 1] if k + 1 < nz else here
            _ascend_plane(
                b, q, dual, radii, known, seams, inverse, step, filled, k, here, above, room
            )


@njit(
    f"void({CUBE}, {CUBE}, {DUAL}, f8[::1], f8[::1], f4, f4, {CUBE}, {FILLED})",
    cache=True,
    parallel=True,
    **OPTIONS,
)
def settle(b, q, dual, radii, inverse, floor, share, x, filled):
    """Write the volume, and the one with momentum, see ``engine``."""
    nz, ny, nx = b.shape
    for plane in prange(nz):
        k, new = np.int64(plane), np.empty(nx, np.float32)
        one, other = np.empty(nx, np.float32), np.empty(nx, np.float32)
        for j in range(ny):
            _line(b, q, dual, radii, inverse, floor, filled, k, j, one, other, new)
            for i in range(nx):
                b[k, j, i] = new[i] + share * (new[i] - x[k, j, i])
            for i in range(nx):
                x[k, j, i] = new[i]


@njit(f"void({CUBE}, {CUBE})", cache=True, parallel=True, **OPTIONS)
def weigh(z, q):
    """Multiply a volume by its weights."""
    nz, ny, nx = z.shape
    for plane in prange(nz):
        k, weights = np.int64(plane), np.empty(nx, np.float32)
        for j in range(ny):
            qk, qj = _rows(q, k, j, z.shape)
            _spread(q[qk, qj], q.shape[2], weights)
            for i in range(nx):
                z[k, j, i] *= weights[i]
