"""Shadows of closed bodies: path lengths of the rays inside, and their derivatives by motion.

``Rays`` is the plain reference, with derivatives. ``MeshRays`` takes whole views fast, with exact
signs; ``_warp_crossings`` has its kernels for a card.
"""

from twinct.rays.body import Body, PixelRectangle, Rays, Shadow
from twinct.rays.mesh_rays import MeshRays, Surface

__all__ = ["Body", "PixelRectangle", "MeshRays", "Rays", "Shadow", "Surface"]
