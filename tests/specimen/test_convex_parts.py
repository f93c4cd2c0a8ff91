"""Convex bodies hold a solid, leave its hollows free, and state what they add to it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from shapely.geometry import Polygon

from twinct.core.errors import MissingExtraError
from twinct.specimen.convex_parts import ROUNDING_MM, beyond, convex_parts, fit_of


def arch(corners: int) -> trimesh.Trimesh:
    """Half a ring of radius 60 and width 20, 30 mm thick."""
    angle = np.linspace(0, np.pi, corners)
    ring = [(60 * np.cos(a), 60 * np.sin(a)) for a in angle]
    ring += [(40 * np.cos(a), 40 * np.sin(a)) for a in angle[::-1]]
    return trimesh.creation.extrude_polygon(Polygon(ring), 30.0)


def bracket() -> trimesh.Trimesh:
    """Two plates of 200 mm, 20 mm thick, at a right angle."""
    profile = [(0, 0), (200, 0), (200, 20), (20, 20), (20, 200), (0, 200)]
    return trimesh.creation.extrude_polygon(Polygon(profile), 100.0)


@pytest.mark.parametrize("corners", [40, 800])
def test_convex_parts_hold_a_solid_and_leave_its_hollow_free(corners: int) -> None:
    """The arch of 800 corners loses most of them before it is cut, and its parts none."""
    solid = arch(corners)
    bodies = convex_parts(solid)
    assert 2 <= len(bodies) <= 8
    on_surface, _ = trimesh.sample.sample_surface(solid, 2000, seed=0)
    outside = np.min([beyond(body, np.array(on_surface)) for body in bodies], axis=0)
    assert outside.max() <= ROUNDING_MM
    hollow = np.array([[0.0, 5.0, 15.0], [10.0, 10.0, 15.0]])
    assert (beyond(solid.convex_hull, hollow) < 0).all()
    assert min(beyond(body, hollow).min() for body in bodies) > 1


def test_the_parts_of_a_bracket_are_its_plates() -> None:
    """The hull stands 90 mm off the edge: its middle, (110, 110), faces both plates at 20 mm."""
    solid = bracket()
    whole, parts = fit_of(solid, [solid.convex_hull]), fit_of(solid, convex_parts(solid))
    assert whole.gap_mm == pytest.approx(90, abs=2)
    assert whole.volume == pytest.approx(1 + 180 * 180 / 2 / 7600, rel=1e-6)
    assert parts.bodies == 2 and parts.volume < 1.01  # the cut misses the edge by a millimetre
    assert parts.gap_mm < 5
    assert whole.words == "1 convex body, 213.2% too large, largest gap 90 mm"


def test_parts_are_equal_in_a_process_that_finds_them_again(
    tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for folder in "ab":
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / folder))
        found.append(convex_parts(arch(40)))
    assert len(list(tmp_path.glob("*/twinct/convex-*.npz"))) == 2
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one.vertices, other.vertices)
        assert np.array_equal(one.faces, other.faces)


def test_convex_and_open_surfaces_are_one_hull_and_need_no_package(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("twinct.specimen.convex_parts.require", _refuse)
    assert len(convex_parts(trimesh.creation.icosphere(3, 80))) == 1
    lid_off = arch(40)
    lid_off.update_faces(np.arange(len(lid_off.faces)) > 3)
    assert len(convex_parts(lid_off)) == 1
    with pytest.raises(MissingExtraError, match="coacd"):
        convex_parts(arch(40))


def _refuse(*_: str) -> None:
    raise MissingExtraError("coacd", "robots")
