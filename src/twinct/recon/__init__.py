"""Reconstruction: projector, algorithms, and RTK's SART for comparison."""

from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem
from twinct.recon.cgls import cgls
from twinct.recon.fast import fast
from twinct.recon.fdk import fdk
from twinct.recon.few_photons import integrals_of_photons
from twinct.recon.known_components import (
    BelievedImplant,
    FittedImplant,
    OneEnergy,
    WithoutImplants,
    without_implants,
)
from twinct.recon.memory import available_bytes, peak_bytes, refuse_if_short
from twinct.recon.metal import WithoutMetal, without_metal
from twinct.recon.orbit import CircularOrbit, fit_circle
from twinct.recon.order import random_order, spread_order, weighted_distance
from twinct.recon.os_sart import os_sart
from twinct.recon.prior_tv import prior_tv
from twinct.recon.projector import Projector
from twinct.recon.registration import registered
from twinct.recon.rtk import rtk_sart
from twinct.recon.sart import sart
from twinct.recon.sirt import sirt
from twinct.recon.steps import Callback, Step
from twinct.recon.surroundings import without_surroundings

__all__ = [
    "Algorithm",
    "AlgorithmSettings",
    "Callback",
    "CircularOrbit",
    "FittedImplant",
    "BelievedImplant",
    "OneEnergy",
    "Problem",
    "Projector",
    "Step",
    "WithoutImplants",
    "WithoutMetal",
    "available_bytes",
    "cgls",
    "fast",
    "fdk",
    "fit_circle",
    "integrals_of_photons",
    "os_sart",
    "peak_bytes",
    "prior_tv",
    "random_order",
    "refuse_if_short",
    "registered",
    "rtk_sart",
    "sart",
    "sirt",
    "spread_order",
    "weighted_distance",
    "without_implants",
    "without_metal",
    "without_surroundings",
]
