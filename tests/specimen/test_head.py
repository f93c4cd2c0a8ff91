"""The head of ``scenarios/head*.yaml``: what is where, and how much of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import ScenarioError
from twinct.geometry import Pose, VolumeGrid
from twinct.scenario import Specimen, load_scenario
from twinct.specimen import build_specimen, material
from twinct.specimen.head import MIDDLE, brain_surface, head_surface
from twinct.specimen.skull import skull_canvas
from twinct.trajectory import commanded_views

SCENARIOS = Path(__file__).parents[2] / "scenarios"
KEV = 60.0
COARSE = {"head": 4.0, "brain": 4.0, "skull": 3.0}
"""Cells of the lattices, mm: what is where does not depend on them, and the tests are fast."""
MESH_REL = 2e-3
"""Tessellation misses the volume of a round body by less than this."""


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(SCENARIOS / "head_screws.yaml")


@pytest.fixture(scope="module")
def specimen(scenario):
    told = scenario.specimen.model_dump(mode="json")
    for part in told["parts"]:
        kind = part["shape"]["kind"]
        part["shape"]["mesh_resolution_mm"] = COARSE.get(
            kind, part["shape"].get("mesh_resolution_mm")
        )
        if kind == "cylinder":
            del part["shape"]["mesh_resolution_mm"]
    return build_specimen(Specimen.model_validate(told))


@pytest.fixture(scope="module")
def parts(specimen):
    return {part.name: part for part in specimen.parts}


def test_the_head_with_screws_is_the_head_and_two_screws(scenario):
    head = load_scenario(SCENARIOS / "head.yaml")
    assert scenario.specimen.parts[:-2] == head.specimen.parts
    assert [p.label for p in scenario.specimen.parts[-2:]] == ["petrous screw", "jaw screw"]


def test_round_parts_have_their_whole_volume(parts):
    """What another part cut would lack some: inserts lie in the brain, eyes beside the bone."""
    for contrast in (1, 2, 4):
        for diameter in (15, 10, 6):
            found = parts[f"insert +{contrast} % {diameter} mm"].volume_mm3
            assert found == pytest.approx(math.pi / 6 * diameter**3, rel=MESH_REL)
    ball, lens = 4 / 3 * math.pi * 12**3, 4 / 3 * math.pi * 4.5 * 2 * 4.5
    for side in ("right", "left"):
        assert parts[f"{side} lens"].volume_mm3 == pytest.approx(lens, rel=MESH_REL)
        assert parts[f"{side} eye"].volume_mm3 == pytest.approx(ball - lens, rel=MESH_REL)
    for screw in ("petrous screw", "jaw screw"):
        assert parts[screw].volume_mm3 == pytest.approx(math.pi * 4 * 40, rel=MESH_REL)


def test_all_parts_are_closed_and_a_brain_has_its_size(specimen, parts):
    assert all(part.mesh.is_watertight for part in specimen.parts)
    assert 1100e3 < parts["brain"].volume_mm3 < 1450e3  # adults, mm^3


def test_inserts_lie_in_the_brain(scenario, inside):
    brain = brain_surface(resolution_mm=COARSE["brain"])
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    inserts = [part for part in scenario.specimen.parts if part.label.startswith("insert")]
    assert len(inserts) == 9
    for part in inserts:
        assert inside(brain, part.position_mm + (part.shape.radius_mm + 1) * corners).all()


@pytest.mark.parametrize(
    ("place", "substance"),
    [
        ((36.8, -7.9, -6.5), "titanium"),  # right; and near both ends of the axis
        ((36.8 + 15.3, -7.9 - 11.3, -6.5), "titanium"),
        ((36.8 - 15.3, -7.9 + 11.3, -6.5), "titanium"),
        ((-36.8, -7.9, -6.5), "bone"),
        ((-32.2, 44.3, -76.8), "titanium"),  # left
        ((-32.2 + 9.0, 44.3 + 16.7, -76.8), "titanium"),
        ((-32.2 - 9.0, 44.3 - 16.7, -76.8), "titanium"),
        ((32.2, 44.3, -76.8), "bone"),
        ((-24, -12, 8), {"of": "brain", "density_g_cm3": 1.04 * 1.04}),
        ((32, -12, 8), "brain"),
        ((-24, -33, 8), {"of": "brain", "density_g_cm3": 1.04 * 1.02}),
        ((2, -54, 8), {"of": "brain", "density_g_cm3": 1.04 * 1.01}),
        ((0, 10, 60), "brain"),
        ((31, 75.3, 5), "eye_lens"),
        ((-31, 75.3, 5), "eye_lens"),
        ((-31, 64, 5), "water"),
        ((0, -50, -50), "soft_tissue"),
        ((27, 61.3, -27.5), None),  # maxillary sinus
        ((0, 12.5, -65), None),  # throat
    ],
)
def test_what_is_at_a_place(specimen, place, substance):
    there = VolumeGrid((3, 3, 3), 0.3, Pose.from_euler(place, (0, 0, 0)))
    truth = specimen.truth(there, KEV, Pose.identity())
    if isinstance(substance, dict):
        substance = (
            Specimen.model_validate(
                {"parts": [{"shape": {"kind": "sphere", "radius_mm": 1}, "material": substance}]}
            )
            .parts[0]
            .material
        )
    wanted = material(substance).mu_per_mm(KEV) if substance else 0.0
    assert truth == pytest.approx(np.full(truth.shape, wanted), rel=1e-5, abs=1e-9)


def test_screws_lie_in_bone_horizontally_and_in_every_view(scenario, specimen, parts, inside):
    skull = (
        build_specimen(
            Specimen.model_validate(
                {"parts": [{"shape": {"kind": "skull", "mesh_resolution_mm": COARSE["skull"]}}]}
            )
        )
        .parts[0]
        .mesh
    )
    geometry = commanded_views(scenario.trajectory, scenario.detector.panel)
    rows, columns = geometry.panel.shape
    for part in scenario.specimen.parts[-2:]:
        axis = part.specimen_from_part.rotation[:, 2]
        assert abs(axis[2]) < 1e-9
        along = np.linspace(-18, 18, 7)[:, None] * axis + part.position_mm
        assert inside(skull, along).all()
        corners = specimen.world_from_specimen.apply(parts[part.label].mesh.vertices)
        for view in range(len(geometry)):
            column, row = np.moveaxis(geometry[view].project(corners)[0], -1, 0)
            assert 0 <= column.min() and column.max() <= columns - 1
            assert 0 <= row.min() and row.max() <= rows - 1


def test_contrast_is_that_of_density_at_any_energy(parts):
    for contrast in (1, 2, 4):
        insert, brain = parts[f"insert +{contrast} % 10 mm"].material, parts["brain"].material
        for kev in (40.0, 100.0):
            share = insert.mu_per_mm(kev) / brain.mu_per_mm(kev)
            assert share == pytest.approx(1 + contrast / 100, rel=1e-9)


def test_figures_are_relative_to_the_named_part(specimen, parts):
    assert specimen.reference_part is parts["skull"]
    assert specimen.largest_part is parts["head"]
    assert specimen.reference_mu(KEV) == material("bone").mu_per_mm(KEV)
    with pytest.raises(ScenarioError, match=r"specimen.reference.*'scull'.*'skull'"):
        load_scenario(SCENARIOS / "head.yaml", ["specimen.reference=scull"])


def test_skin_lies_about_the_bones_and_is_symmetric():
    bones = skull_canvas(3.0).surface()
    assert bones.bounds.mean(axis=0) == pytest.approx(MIDDLE, abs=0.3)
    head = head_surface(resolution_mm=4.0)
    beyond = (head.bounds - (bones.bounds - MIDDLE)) * [[-1], [1]]
    assert 2 < beyond.min(), "mm from bone to skin"
    assert head.bounds.sum(axis=0)[0] == pytest.approx(0, abs=1e-4)
    assert np.ptp(head_surface(0.5, 4.0).bounds, axis=0) == pytest.approx(
        np.ptp(head.bounds, axis=0) / 2, abs=4
    )


def test_a_coarser_ball_keeps_its_volume():
    shape = {"kind": "sphere", "radius_mm": 5}
    fine, coarse = (
        build_specimen(Specimen.model_validate({"parts": [{"shape": shape | more}]})).parts[0].mesh
        for more in ({}, {"mesh_resolution_mm": 1.0})
    )
    assert len(coarse.faces) < len(fine.faces) / 10
    assert coarse.edges_unique_length.max() <= 1.0
    assert coarse.volume == pytest.approx(4 / 3 * math.pi * 125, rel=1e-9)
