"""X-ray projections by gVXR, the only module that speaks to it."""

from twinct.xray.imager import Imager

__all__ = ["Imager"]
