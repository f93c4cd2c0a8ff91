"""The vector engine: kernels written eight samples at a time, in LLVM's own words.

Why they are fast: eight samples are read and blended by one piece of vector code (``march``,
``sample``); tiles of rays go through the volume slab by slab, in copies of just the voxels they
cross (``brick``). No result depends on the number of threads.
"""

from numba import get_num_threads

from twinct.recon._vector.cache import kernels_from_disk

with kernels_from_disk():
    from twinct.recon._vector import adjoint as _adjoint
    from twinct.recon._vector.forward import forward
    from twinct.recon._vector.rays import chords
    from twinct.recon._vector.readable import ascend, back_project, primal, ratio
    from twinct.recon._vector.update import update

__all__ = ["adjoint", "ascend", "back_project", "chords", "forward", "primal", "ratio", "update"]


def adjoint(y, rays, out):
    """Add the exact transpose of ``forward`` applied to ``y`` to ``out``."""
    _adjoint.adjoint(y, rays, out, get_num_threads())
