"""Shells of one mesh file: what lies in two of them counts once, cavities stay empty."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twinct.core.errors import SpecimenError
from twinct.geometry import VolumeGrid
from twinct.scenario import Specimen
from twinct.specimen import build_specimen

ENERGY_KEV = 80.0
SINGLE = 1e-6
"""Relative: STL files hold single precision."""


def box(low, high, *, inwards=False):
    mesh = trimesh.creation.box(bounds=[low, high])
    if inwards:
        mesh.invert()
    return mesh


@pytest.fixture
def build(tmp_path):
    def make(*shells):
        trimesh.util.concatenate(shells).export(tmp_path / "shells.stl")
        shape = {"kind": "mesh", "path": tmp_path / "shells.stl"}
        part = {"name": "casting", "shape": shape, "material": "aluminium"}
        return build_specimen(Specimen.model_validate({"parts": [part]}))

    return make


def mesh_of(built):
    return built.parts[0].mesh


def test_what_lies_in_two_shells_counts_once(build, caplog):
    """Two bars of 20.4 mm that overlap by half make a way of 30.6 mm, not of 40.8."""
    built = build(box((0, 0, 0), (20.4, 8, 8)), box((10.2, 2, 2), (30.6, 6, 6)))
    mesh = mesh_of(built)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(20.4 * 64 + 10.2 * 16, rel=SINGLE)
    grid = VolumeGrid((8, 8, 16), (2.0, 1.0, 1.0), built.world_from_specimen)
    mu = built.reference_mu(ENERGY_KEV)
    truth = built.truth(grid, ENERGY_KEV)
    assert truth.max() == pytest.approx(mu, rel=SINGLE)
    assert "overlap" in caplog.text and "'casting'" in caplog.text and "163 mm^3" in caplog.text


def test_a_shell_within_another_turned_the_same_way_adds_nothing(build):
    built = build(box((0, 0, 0), (9, 9, 9)), box((3, 3, 3), (6, 6, 6)))
    assert mesh_of(built).volume == pytest.approx(9**3, rel=SINGLE)


@pytest.mark.parametrize(
    ("shells", "volume"),
    [
        ([((0, 0, 0), (9, 9, 9), False), ((3, 3, 3), (6, 6, 6), True)], 9**3 - 27),
        (
            [
                ((0, 0, 0), (9, 9, 9), False),
                ((1, 1, 1), (8, 8, 8), True),
                ((2, 2, 2), (5, 5, 5), False),
                ((3, 3, 3), (4, 4, 4), True),
            ],
            9**3 - 7**3 + 27 - 1,
        ),
        ([((0, 0, 0), (5, 5, 5), False), ((5, 1, 1), (9, 4, 4), False)], 125 + 36),
        ([((0, 0, 0), (5, 5, 5), False), ((7, 1, 1), (9, 4, 4), False)], 125 + 18),
    ],
    ids=["cavity", "island in a cavity", "touching", "apart"],
)
def test_shells_that_do_not_overlap_stay_as_they_are(build, caplog, shells, volume):
    meshes = [box(low, high, inwards=inwards) for low, high, inwards in shells]
    mesh = mesh_of(build(*meshes))
    assert mesh.volume == pytest.approx(volume, rel=SINGLE)
    corners = np.unique(np.concatenate([m.vertices for m in meshes]), axis=0)
    np.testing.assert_array_equal(np.unique(mesh.vertices, axis=0), corners)
    assert len(mesh.faces) == 12 * len(shells)
    assert not caplog.records


def test_a_cavity_stays_in_shells_that_are_united(build):
    overlapping = box((0, 0, 0), (9, 9, 9)), box((8, 0, 0), (12, 9, 9))
    mesh = mesh_of(build(*overlapping, box((3, 3, 3), (6, 6, 6), inwards=True)))
    assert mesh.volume == pytest.approx(12 * 81 - 27, rel=SINGLE)


@pytest.mark.parametrize(
    ("low", "high"),
    [((20, 0, 0), (24, 2, 2)), ((7, 3, 3), (11, 5, 5))],
    ids=["outside", "crossing"],
)
def test_a_shell_turned_inside_out_in_no_other_is_refused_with_its_place(build, low, high):
    x, y, z = (np.array(low) + np.array(high)) / 2
    with pytest.raises(SpecimenError, match=rf"shells.stl: .*around \({x:g}, {y:g}, {z:g}\) mm"):
        build(box((0, 0, 0), (9, 9, 9)), box(low, high, inwards=True))
