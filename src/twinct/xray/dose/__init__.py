"""Dose to a specimen by views, and the figures by which C-arms report it."""

from twinct.xray.dose.effective_dose import EffectiveDose, effective_dose
from twinct.xray.dose.place_doses import PathDose, PlaceDoses
from twinct.xray.dose.reference_kerma import kerma_area_product_gy_cm2, reference_kerma_gy

__all__ = [
    "EffectiveDose",
    "PathDose",
    "PlaceDoses",
    "effective_dose",
    "kerma_area_product_gy_cm2",
    "reference_kerma_gy",
]
