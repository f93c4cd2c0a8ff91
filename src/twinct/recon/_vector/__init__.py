"""Vector engine: kernels written sixteen samples at a time, in LLVM instructions.

It is fast because one piece of vector code reads and blends sixteen samples (``march`` and
``sample``; with AVX-512 ``windows`` and ``cells``), and because tiles of rays go through the volume
slab by slab, in copies of only the voxels that they cross (``brick``). No result depends on the
number of threads.
"""

import numpy as np
from numba import get_num_threads

from twinct.recon._vector.cache import kernels_from_disk
from twinct.recon.blocks import EVERYWHERE

with kernels_from_disk():
    from twinct.recon import _linear as _linear  # compiled with the others
    from twinct.recon import _plain
    from twinct.recon._plain import ascend, bring, hold, leave_out, require, room, settle, weigh
    from twinct.recon._vector import adjoint as _adjoint
    from twinct.recon._vector.forward import forward as _forward
    from twinct.recon._vector.options import CUBE, IMAGE, MATRICES, STACK, kernel
    from twinct.recon._vector.rays import chords
    from twinct.recon._vector.update import update as _update

    # The plain engine's code is fast already; here it gets fast mathematics.
    ratio = kernel(
        f"({IMAGE}, {IMAGE}, {IMAGE}, f4, f4, {IMAGE}, {IMAGE}, i4[:, ::1])", parallel=False
    )(_plain.ratio.py_func)
    back_project = kernel(f"({STACK}, {MATRICES}, f8[::1], {CUBE})")(_plain.back_project.py_func)

__all__ = [
    "adjoint",
    "ascend",
    "back_project",
    "bring",
    "chords",
    "forward",
    "hold",
    "leave_out",
    "ratio",
    "require",
    "room",
    "settle",
    "update",
    "weigh",
]


_NO_LENGTHS = np.empty((0, 0), np.float32)


def forward(x, rays, out, blocks=EVERYWHERE, lengths=None):
    """Write the line integrals of ``x``, see ``engine``."""
    _forward(x, rays, out, _NO_LENGTHS if lengths is None else lengths, blocks.sums)


def update(x, pixels, image, counts, missing, floor, blocks=EVERYWHERE):
    """Update the voxels, see ``engine``."""
    _update(x, pixels, image, counts, missing, floor, blocks.filled)


def adjoint(y, rays, out):
    """Add the exact transpose of ``forward``, applied to ``y``, to ``out``."""
    _adjoint.adjoint(y, rays, out, get_num_threads())
