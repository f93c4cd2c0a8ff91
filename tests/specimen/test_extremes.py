"""Bodies that validate and cannot be built are refused by key; what can be built is."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import SpecimenError
from twinct.scenario import Specimen
from twinct.specimen import BuiltSpecimen, build_specimen


def built(shape: dict[str, object], **part: object) -> BuiltSpecimen:
    return build_specimen(Specimen.model_validate({"parts": [{"shape": shape, **part}]}))


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        # Found by tools/fuzz bodies: no point of the lattice lies in the bone.
        ({"kind": "skull", "mesh_resolution_mm": 117.0}, "mesh_resolution_mm 117 is too coarse"),
        ({"kind": "skull", "scale": 0.001}, "too coarse for a skull of scale 0.001"),
        ({"kind": "head", "mesh_resolution_mm": 1e6}, "too coarse for a head"),
        (
            {"kind": "box", "size_mm": (1e-6, 1, 1)},
            "specimen.parts.0.shape: part .* small",
        ),
        ({"kind": "box", "size_mm": (1e-3, 1e5, 1e5)}, "specimen.parts.0.shape: .* too flat"),
    ],
)
def test_what_cannot_be_built_is_named(shape: dict[str, object], said: str) -> None:
    with pytest.raises(SpecimenError, match=said):
        built(shape)


@pytest.mark.parametrize("size", [(1e-4, 100, 100), (2e-5, 2e-5, 2e-5), (1e6, 1e6, 1e6)])
def test_thin_small_and_large_bodies_have_a_hull(size: tuple[float, ...]) -> None:
    body = built({"kind": "box", "size_mm": size})
    assert np.ptp(body.hull.bounds, axis=0) == pytest.approx(size)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (1e308, "at most 1e.06"),
        (1e-9, "at least 1e-06"),
        (float("nan"), "finite"),
        (-1.0, "than 0"),
    ],
)
def test_lengths_are_those_of_things(value: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Specimen.model_validate({"parts": [{"shape": {"kind": "sphere", "radius_mm": value}}]})
