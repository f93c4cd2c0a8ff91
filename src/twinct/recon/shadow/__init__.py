"""Shadows of closed bodies: path lengths of the rays inside, and their derivatives by motion."""

from twinct.recon.shadow.body import Body, Box, Rays, Shadow

__all__ = ["Body", "Box", "Rays", "Shadow"]
