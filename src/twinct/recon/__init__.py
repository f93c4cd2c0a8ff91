"""Reconstruction: projector, SART, and RTK's SART to compare with."""

from twinct.recon.projector import Projector
from twinct.recon.rtk import rtk_sart
from twinct.recon.sart import sart, spread_order

__all__ = ["Projector", "rtk_sart", "sart", "spread_order"]
