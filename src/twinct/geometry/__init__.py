"""Poses, scan geometries and voxel grids: the only spatial types that modules share.

Points are (x, y, z) in mm, right-handed, world origin at the isocentre, z up. A view is four
vectors: source S, panel centre D, and the unit vectors u (along +column) and v (along +row) with
u x v pointing to the source. Pixel (r, c) has its centre at

    D + (c - (columns - 1) / 2) pitch_u u + (r - (rows - 1) / 2) pitch_v v.

Frames: the detector frame has axes (u, v, u x v); the source frame has z towards the panel centre
and x as near to u as possible. Only ``to_*`` and ``from_*`` may reorder axes or change units.
"""

from twinct.geometry.arrays import UNIT_TOLERANCE, Floats, lock
from twinct.geometry.chain import Chain, Misfit, exp_matrices
from twinct.geometry.directions import fibonacci_directions
from twinct.geometry.grid import VolumeGrid, part_of
from twinct.geometry.panel import Panel
from twinct.geometry.pose import MM_PER_M, Pose
from twinct.geometry.scan import ScanGeometry

__all__ = [
    "part_of",
    "MM_PER_M",
    "UNIT_TOLERANCE",
    "Chain",
    "Floats",
    "Misfit",
    "Panel",
    "Pose",
    "ScanGeometry",
    "VolumeGrid",
    "exp_matrices",
    "fibonacci_directions",
    "lock",
]
