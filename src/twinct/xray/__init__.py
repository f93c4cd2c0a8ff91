"""X-ray projections by gVXR, the only module that speaks to it."""

from twinct.xray.imager import Imager, prepare_engine

__all__ = ["Imager", "prepare_engine"]
