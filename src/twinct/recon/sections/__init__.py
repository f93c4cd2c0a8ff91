"""The reconstruction, as a scenario states it."""

from twinct.recon.sections.beam_hardening import (
    BeamHardening,
    OneMaterialHardening,
    TwoMaterialHardening,
)
from twinct.recon.sections.known_motion import COMPENSATING, KnownMotion, motion_conflicts
from twinct.recon.sections.metal import Implant, KnownImplants, Metal, Nmar
from twinct.recon.sections.reconstruction import (
    DEFAULT_ALGORITHM,
    SECTIONS,
    AnyReconstruction,
    Around,
    Grid,
    Reconstruction,
    Surroundings,
    Zoom,
    own_keys,
)

__all__ = [
    "AnyReconstruction",
    "Around",
    "BeamHardening",
    "COMPENSATING",
    "DEFAULT_ALGORITHM",
    "Grid",
    "Implant",
    "KnownImplants",
    "KnownMotion",
    "Metal",
    "Nmar",
    "OneMaterialHardening",
    "Reconstruction",
    "SECTIONS",
    "Surroundings",
    "TwoMaterialHardening",
    "Zoom",
    "motion_conflicts",
    "own_keys",
]
