"""Reconstruction: projector, SART, and RTK's SART to compare with."""

from twinct.recon.projector import Projector
from twinct.recon.sart import sart, spread_order

__all__ = ["Projector", "sart", "spread_order"]
