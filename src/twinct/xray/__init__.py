"""X-ray projections, by gVXR or another engine; no other package calls gVXR."""

from twinct.xray.engines import prepare_engine
from twinct.xray.imager import Imager

__all__ = ["Imager", "prepare_engine"]
