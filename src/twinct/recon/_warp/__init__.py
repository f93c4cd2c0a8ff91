"""Engine cuda: the kernels on a card, by Warp.

Volumes stay on the card from one call to the next, if the caller ``hold``s them there; other arrays
are copied to the card and back in each call. No sum depends on the order of threads: each thread
gathers into one pixel or voxel of its own.
"""

from twinct.recon._warp.engine import WarpKernels

__all__ = ["WarpKernels"]
