"""Checks that source and detector can be built, before any work and without gVXR."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from twinct.core.errors import InputError, MissingExtraError
from twinct.geometry import ScanGeometry
from twinct.xray import sections
from twinct.xray.beam_shape import nodes_of
from twinct.xray.build import (
    build_bad_pixels,
    build_beam,
    build_response,
    build_spot,
    build_spread,
)
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum

T = TypeVar("T")

_UNCOVERED = 1e-3
"""Maximum share of the photons outside a tabulated response."""
_WIDEST_SPOT = 0.25
"""Maximum width of a focal spot, as a share of the distance to the panel."""


def check_parts(
    source: sections.Source, detector: sections.Detector, views: ScanGeometry, seed: int = 0
) -> None:
    """Build every part of the chain once, and check that it suits the commanded views.

    Raises:
        InputError: a file, material or number is unusable; lists all of them by key.
        MissingExtraError: SpekPy is needed and not installed.
    """
    problems: list[str] = []

    def of(build: Callable[[], T]) -> T | None:
        try:
            return build()
        except MissingExtraError:
            raise
        except InputError as error:
            problems.extend(error.problems)

    beam = of(lambda: build_beam(source))
    response = of(lambda: build_response(detector))
    of(lambda: build_spread(detector))
    of(lambda: build_bad_pixels(detector, seed))
    if beam is not None and not beam.uniform:
        for view in views:  # corners see the largest angles to the central ray
            ends = (nodes[[0, -1]] for nodes in nodes_of(view))
            if of(lambda view=view, ends=ends: beam.factors(view, *ends)) is None:
                break
    if of(lambda: build_spot(source)) is not None:
        problems += _spot_problems(source, views)
    if beam is not None and response is not None:
        problems += _response_problems(beam.spectrum, response)
    if problems:
        raise InputError(problems)


def _response_problems(spectrum: PhotonSpectrum, response: PhotonResponse) -> list[str]:
    low, high = response.range_kev
    energies = spectrum.energies_kev
    outside = (energies < low) | (energies > high)
    share = float(spectrum.photons[outside].sum() / spectrum.total)
    if share > _UNCOVERED:
        return [
            f"detector.response.path: {response.name} covers {low:g} to {high:g} keV, but "
            f"{100 * share:.3g} % of the source's photons, which have {energies[0]:.4g} to "
            f"{energies[-1]:.4g} keV, lie outside; at most {100 * _UNCOVERED:g} % may"
        ]
    if not (spectrum.photons * response.mean(energies)).sum() > 0:
        return [f"detector.response: {response.name} absorbs none of the source's photons"]
    return []


def _spot_problems(source: sections.Source, views: ScanGeometry) -> list[str]:
    section = source.focal_spot
    if section is None:
        return []
    if isinstance(section, sections.GaussianSpot):
        key, width = "sigma_mm", 4 * np.max(section.sigma_mm)
    else:
        key, width = "size_mm", np.max(section.size_mm)
    distance = views.sdd_to_centre.min()
    limit = _WIDEST_SPOT * float(distance)
    if width <= limit:
        return []
    return [
        f"source.focal_spot.{key}: a spot {width:g} mm wide"
        f"{' (4 sigma)' if key == 'sigma_mm' else ''} is too wide; at most {limit:g} mm are "
        f"allowed, a quarter of the distance of {distance:g} mm to the panel"
    ]
