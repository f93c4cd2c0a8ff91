"""Shadows of closed bodies: how far each ray runs inside, and what a motion of the body changes."""

from twinct.shadow.body import Body, Box, Rays, Shadow

__all__ = ["Body", "Box", "Rays", "Shadow"]
