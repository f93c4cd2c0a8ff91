"""X-ray projections by gVXR; no other package calls gVXR."""

from twinct.xray.imager import Imager, prepare_engine

__all__ = ["Imager", "prepare_engine"]
