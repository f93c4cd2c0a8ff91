"""Warp kernels that go voxel by voxel: residual images, back projections, total variation.

The formulas are those of the plain engine. Projected places are computed in float32, relative to
the middles of grid and panel, so that they keep their digits.
"""

import warp as wp

MATRIX = wp.types.matrix(shape=(3, 4), dtype=wp.float32)
"""Projection matrix."""


@wp.kernel
def leave_out(length: wp.array2d(dtype=float), mask: wp.array2d(dtype=wp.bool)):
    """Set the lengths of masked pixels to 0."""
    row, column = wp.tid()
    if not mask[row, column]:
        length[row, column] = 0.0


@wp.kernel
def write_ratio(
    measured: wp.array2d(dtype=float),
    estimate: wp.array2d(dtype=float),
    length: wp.array2d(dtype=float),
    relaxation: float,
    shortest: float,
    image: wp.array2d(dtype=float),
    counts: wp.array2d(dtype=float),
):
    """Write residual over path length for the rays that count, with a border of one pixel."""
    row, column = wp.tid()
    r = wp.clamp(row - 1, 0, measured.shape[0] - 1)
    c = wp.clamp(column - 1, 0, measured.shape[1] - 1)
    if length[r, c] >= shortest:
        image[row, column] = relaxation * (measured[r, c] - estimate[r, c]) / length[r, c]
        counts[row, column] = 1.0
    else:
        image[row, column] = 0.0
        counts[row, column] = 0.0


@wp.func
def _bilinear(image: wp.array2d(dtype=float), row: float, column: float):
    r = int(row)
    c = int(column)
    g = row - float(r)
    f = column - float(c)
    low = (1.0 - f) * image[r, c] + f * image[r, c + 1]
    high = (1.0 - f) * image[r + 1, c] + f * image[r + 1, c + 1]
    return (1.0 - g) * low + g * high


@wp.func
def _seen(matrix: MATRIX, middle: wp.vec3f, i: int, j: int, k: int):
    """Return column and row, relative to the panel's middle, and the depth of a voxel."""
    place = wp.vec4f(float(i) - middle[0], float(j) - middle[1], float(k) - middle[2], 1.0)
    seen = matrix * place
    return wp.vec3f(seen[0] / seen[2], seen[1] / seen[2], seen[2])


@wp.kernel
def update(
    x: wp.array3d(dtype=float),
    matrix: MATRIX,
    middle: wp.vec3f,
    image: wp.array2d(dtype=float),
    counts: wp.array2d(dtype=float),
    floor: float,
    filled: wp.array3d(dtype=wp.uint8),
):
    """Add the mean of the counting pixels at each voxel's projection, above a floor.

    Voxels of blocks of 8^3 that are not ``filled`` stay as they are; if it is empty, all are.
    """
    k, j, i = wp.tid()
    if filled.shape[0] > 0:
        if filled[k // 8, j // 8, i // 8] == wp.uint8(0):
            return
    rows = image.shape[0] - 2
    columns = image.shape[1] - 2
    seen = _seen(matrix, middle, i, j, k)
    half_column = 0.5 * float(columns)
    half_row = 0.5 * float(rows)
    if wp.abs(seen[0]) <= half_column and wp.abs(seen[1]) <= half_row:
        # The image has a border of one pixel.
        column = seen[0] + half_column + 0.5
        row = seen[1] + half_row + 0.5
        weight = _bilinear(counts, row, column)
        change = float(0.0)
        if weight > 1.0e-3:
            change = _bilinear(image, row, column) / weight
        x[k, j, i] = wp.max(x[k, j, i] + change, floor)


@wp.kernel
def back_project(
    images: wp.array3d(dtype=float),
    matrices: wp.array(dtype=MATRIX),
    scales: wp.array(dtype=float),
    middle: wp.vec3f,
    out: wp.array3d(dtype=float),
):
    """Add scale / depth^2 times each image at a voxel's projection, in the order of the views."""
    k, j, i = wp.tid()
    rows = images.shape[1]
    columns = images.shape[2]
    half_column = 0.5 * float(columns)
    half_row = 0.5 * float(rows)
    total = out[k, j, i]
    for view in range(images.shape[0]):
        seen = _seen(matrices[view], middle, i, j, k)
        if wp.abs(seen[0]) <= half_column and wp.abs(seen[1]) <= half_row:
            column = wp.clamp(seen[0] + half_column - 0.5, 0.0, float(columns - 1))
            row = wp.clamp(seen[1] + half_row - 0.5, 0.0, float(rows - 1))
            c = int(column)
            r = int(row)
            c1 = wp.min(c + 1, columns - 1)
            r1 = wp.min(r + 1, rows - 1)
            f = column - float(c)
            g = row - float(r)
            low = images[view, r, c] + f * (images[view, r, c1] - images[view, r, c])
            high = images[view, r1, c] + f * (images[view, r1, c1] - images[view, r1, c])
            total += scales[view] / (seen[2] * seen[2]) * (low + g * (high - low))
    out[k, j, i] = total


WHOLE = wp.constant(32767.0)
"""Stored length of a dual vector as long as its radius."""


@wp.func
def _weight(q: wp.array3d(dtype=float), shape: wp.vec3i, k: int, j: int, i: int) -> float:
    """Return the weight of a voxel, perhaps of one twice as large."""
    if q.shape[0] != shape[0]:
        k = k // 2
    if q.shape[1] != shape[1]:
        j = j // 2
    if q.shape[2] != shape[2]:
        i = i // 2
    return q[k, j, i]


@wp.func
def _holds(filled: wp.array3d(dtype=wp.uint8), k: int, j: int, i: int) -> bool:
    """Return True if a voxel may hold something."""
    if filled.shape[0] == 0:
        return True
    return filled[k // 8, j // 8, i // 8] != wp.uint8(0)


@wp.kernel
def weigh(z: wp.array3d(dtype=float), q: wp.array3d(dtype=float)):
    """Multiply a volume by its weights."""
    k, j, i = wp.tid()
    shape = wp.vec3i(z.shape[0], z.shape[1], z.shape[2])
    z[k, j, i] = z[k, j, i] * _weight(q, shape, k, j, i)


@wp.kernel
def lower(
    b: wp.array3d(dtype=float),
    q: wp.array3d(dtype=float),
    dual: wp.array4d(dtype=wp.int16),
    radii: wp.array(dtype=float),
    inverse: wp.vec3f,
    floor: float,
    filled: wp.array3d(dtype=wp.uint8),
    out: wp.array3d(dtype=float),
):
    """Write max((b - D^T p) / q, floor) in filled blocks, with forward differences D."""
    k, j, i = wp.tid()
    if not _holds(filled, k, j, i):
        out[k, j, i] = 0.0
        return
    value = b[k, j, i]
    for n in range(radii.shape[0]):
        turned = -inverse[0] * float(dual[3 * n, k, j, i]) - inverse[1] * float(
            dual[3 * n + 1, k, j, i]
        )
        turned -= inverse[2] * float(dual[3 * n + 2, k, j, i])
        if i > 0:
            turned += inverse[0] * float(dual[3 * n, k, j, i - 1])
        if j > 0:
            turned += inverse[1] * float(dual[3 * n + 1, k, j - 1, i])
        if k > 0:
            turned += inverse[2] * float(dual[3 * n + 2, k - 1, j, i])
        value -= radii[n] / WHOLE * turned
    shape = wp.vec3i(b.shape[0], b.shape[1], b.shape[2])
    out[k, j, i] = wp.max(value / _weight(q, shape, k, j, i), floor)


@wp.kernel
def ascend(
    x: wp.array3d(dtype=float),
    q: wp.array3d(dtype=float),
    known: wp.array3d(dtype=float),
    seams: wp.array3d(dtype=wp.uint8),
    inverse: wp.vec3f,
    radii: wp.array(dtype=float),
    scale: float,
    lines: wp.array2d(dtype=wp.uint8),
    dual: wp.array4d(dtype=wp.int16),
):
    """Step along the gradient of x, with a step for each voxel, then project into the ball.

    ``lines`` are 1 where a line of blocks along x has a filled one; empty, all have.
    """
    n, k, j, i = wp.tid()
    if radii[n] <= 0.0:
        return
    if lines.shape[0] > 0:
        if lines[k // 8, j // 8] == wp.uint8(0):
            return
    shape = wp.vec3i(x.shape[0], x.shape[1], x.shape[2])
    beside = wp.vec3i(
        wp.min(i + 1, shape[2] - 1), wp.min(j + 1, shape[1] - 1), wp.min(k + 1, shape[0] - 1)
    )
    value = x[k, j, i]
    s = _weight(q, shape, k, j, i)
    # Both voxels of a weight's two along x take the next weight, as the other engines have it.
    further = i + 1
    if q.shape[2] != shape[2]:
        further = i // 2 * 2 + 2
    s = wp.min(s, _weight(q, shape, k, j, wp.min(further, shape[2] - 1)))
    s = wp.min(s, _weight(q, shape, k, beside[1], i))
    s = wp.min(s, _weight(q, shape, beside[2], j, i))
    ahead = wp.vec3f(x[k, j, beside[0]], x[k, beside[1], i], x[beside[2], j, i])
    if n == 1:
        value -= known[k, j, i]
        ahead -= wp.vec3f(known[k, j, beside[0]], known[k, beside[1], i], known[beside[2], j, i])
    rise = wp.vec3f(
        float(dual[3 * n, k, j, i]),
        float(dual[3 * n + 1, k, j, i]),
        float(dual[3 * n + 2, k, j, i]),
    )
    step = ahead - wp.vec3f(value, value, value)
    rise += scale / radii[n] * WHOLE * s * wp.cw_mul(inverse, step)
    square = wp.dot(rise, rise)
    if square > WHOLE * WHOLE:
        rise = rise * (WHOLE / wp.sqrt(square))
    if n == 1:
        if seams[k, j, i] != wp.uint8(0):
            rise = wp.vec3f(0.0, 0.0, 0.0)
    for axis in range(3):
        dual[3 * n + axis, k, j, i] = wp.int16(wp.rint(rise[axis]))


@wp.kernel
def settle(
    x: wp.array3d(dtype=float),
    share: float,
    b: wp.array3d(dtype=float),
    before: wp.array3d(dtype=float),
):
    """Write x + share (x - before) to b, and x to ``before``."""
    k, j, i = wp.tid()
    b[k, j, i] = x[k, j, i] + share * (x[k, j, i] - before[k, j, i])
    before[k, j, i] = x[k, j, i]
