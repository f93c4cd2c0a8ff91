"""Kernels: from path lengths to the signal of each pixel, summed over its samples."""

import numpy as np
from numba import njit, prange

LOG2_E = np.float32(1.4426950408889634)
DARKEST_LOG2 = np.float32(-126.0)
"""Lower limit of log2 of the transmission: below it, floats lose digits, and nothing is visible."""

# exp2 on [-0.5, 0.5]: Taylor coefficients ln(2)^k / k!, relative error 1e-7.
C1 = np.float32(0.6931471805599453)
C2 = np.float32(0.24022650695910072)
C3 = np.float32(0.05550410866482158)
C4 = np.float32(0.009618129107628477)
C5 = np.float32(0.0013333558146428443)
C6 = np.float32(0.00015403530393381608)

OPTIONS = {"cache": True, "nogil": True, "fastmath": True, "error_model": "numpy"}


@njit(**OPTIONS)
def _transmit(mu, rows, bits, scale, work):
    """Write the transmission of one energy behind ``rows`` (materials, n) path lengths to ``work``.

    Plain loops without calls or branches let the compiler generate SIMD code.
    """
    n = rows.shape[1]
    for i in range(n):
        work[i] = np.float32(0.0)
    for m in range(rows.shape[0]):
        factor = -mu[m] * LOG2_E
        for i in range(n):
            work[i] += factor * rows[m, i]
    for i in range(n):
        x = max(work[i], DARKEST_LOG2)
        whole = np.floor(x + np.float32(0.5))
        f = x - whole
        bits[i] = (np.int32(whole) + np.int32(127)) << np.int32(23)
        work[i] = np.float32(1.0) + f * (C1 + f * (C2 + f * (C3 + f * (C4 + f * (C5 + f * C6)))))
    for i in range(n):
        work[i] *= scale[i]


@njit(**OPTIONS)
def _shade(nodes, row, cells, fractions, line, work):
    """Multiply ``work`` by the factors of ``nodes`` (v, u), linear between them."""
    first = min(np.int32(row), np.int32(nodes.shape[0] - 2))
    part = row - np.float32(first)
    for k in range(nodes.shape[1]):
        line[k] = nodes[first, k] + part * (nodes[first + 1, k] - nodes[first, k])
    for i in range(len(work)):
        k = cells[i]
        work[i] *= line[k] + fractions[i] * (line[k + 1] - line[k])


@njit(parallel=True, **OPTIONS)
def sum_bins(paths, mus, means, squares, beam, samples, share, shading, out):
    """Add the signal of every bin to ``out``: mean and mean square, (2, rows, columns).

    ``paths`` (materials, rows * samples, columns * samples) are in mm, ``mus`` (bins, materials) in
    1/mm. ``means`` and ``squares`` (bins,) weight the bins, ``beam`` each sample, ``share`` the
    total. ``shading`` has factors on the bins: see ``Shading``; without bins, there are none.
    """
    rows, n = out.shape[1], paths.shape[2]
    factor = np.float32(share / (samples * samples))
    table, at_rows, at_columns = shading
    shaded, nodes = table.shape[0] > 0, table.shape[2]
    cells = np.zeros(n, np.int32)
    fractions = np.zeros(n, np.float32)
    if shaded:
        for i in range(n):
            cells[i] = min(np.int32(at_columns[i]), np.int32(nodes - 2))
            fractions[i] = at_columns[i] - np.float32(cells[i])
    for row in prange(rows):
        bits = np.empty(n, np.int32)
        scale = bits.view(np.float32)
        sums = np.empty((2, n), np.float32)
        work = np.empty(n, np.float32)
        line = np.empty(nodes, np.float32)
        for sub in range(row * samples, (row + 1) * samples):
            sums[:] = np.float32(0.0)
            here = paths[:, sub]
            for b in range(len(means)):
                _transmit(mus[b], here, bits, scale, work)
                if shaded:
                    _shade(table[b], at_rows[sub], cells, fractions, line, work)
                for i in range(n):
                    sums[0, i] += means[b] * work[i]
                    sums[1, i] += squares[b] * work[i]
            for i in range(n):
                weight = factor * beam[sub, i]
                out[0, row, i // samples] += weight * sums[0, i]
                out[1, row, i // samples] += weight * sums[1, i]


@njit(**OPTIONS)
def look_up(paths, longest, table, beam, samples, share, out):
    """Add the signal behind one material to ``out`` from a table over sqrt(path / longest).

    The table (2, nodes) holds mean and mean square, linear between nodes; ``longest`` is the path
    length at the last node, mm. Single-threaded: it takes 2 ms, and waiting threads would take time
    from gVXR's.
    """
    rows, n = out.shape[1], paths.shape[1]
    last = np.int32(table.shape[1] - 1)
    factor = np.float32(share / (samples * samples))
    scale = np.float32(1.0 / longest)
    means, squares = table[0], table[1]
    mean, square = np.empty(n, np.float32), np.empty(n, np.float32)
    for row in range(rows):
        for sub in range(row * samples, (row + 1) * samples):
            for i in range(n):
                t = np.sqrt(paths[sub, i] * scale) * np.float32(last)
                t = min(t, np.float32(last))
                k = min(np.int32(t), last - np.int32(1))
                f = t - np.float32(k)
                g = np.float32(1.0) - f
                weight = factor * beam[sub, i]
                mean[i] = weight * (g * means[k] + f * means[k + 1])
                square[i] = weight * (g * squares[k] + f * squares[k + 1])
            if samples == 1:
                for i in range(n):
                    out[0, row, i] += mean[i]
                    out[1, row, i] += square[i]
            else:
                for i in range(n):
                    out[0, row, i // samples] += mean[i]
                    out[1, row, i // samples] += square[i]
