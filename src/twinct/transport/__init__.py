"""Monte Carlo transport of photons up to 150 keV in bodies of voxels: dose and scatter."""

from twinct.transport.beam import Beam
from twinct.transport.grid import AntiScatterGrid
from twinct.transport.regions import Regions
from twinct.transport.scores import ORDERS, Scores
from twinct.transport.simulation import Detector, Simulation, integrating
from twinct.transport.voxel_body import VoxelBody

__all__ = [
    "ORDERS",
    "AntiScatterGrid",
    "Beam",
    "Detector",
    "Regions",
    "Scores",
    "Simulation",
    "VoxelBody",
    "integrating",
]
