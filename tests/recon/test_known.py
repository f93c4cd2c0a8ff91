"""Known implants in a small analytic scene: found, and taken out of the line integrals."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.rays import Body, Rays
from twinct.recon import Projector, sart
from twinct.recon.known_components import BelievedImplant, OneEnergy, without_implants

TISSUE, BONE, METAL = 0.02, 0.05, 0.3
HEAD, BONES = ((0, 0, 0), (22, 20, 18)), ((2, 3, -1), (13, 9, 7))
PLACE = Pose.from_euler((3, 3, -1), (70, 10, 30))
NOISE = 0.01
JITTER_MM = 0.1


def rod():
    mesh = trimesh.creation.cylinder(1.5, 12.0, sections=32)
    return Body(mesh.vertices, mesh.faces)


def integrals(geometry, body, pose):
    images, rays = np.zeros((len(geometry), *geometry.panel.shape)), Rays(geometry)
    for view, image in enumerate(images):
        box, lengths, _ = rays.shadow(body, pose, view)
        image[box] = lengths
    return images


@pytest.fixture
def scene(circle, ellipsoid_integrals):
    """Projector from believed poses, line integrals with a rod and without, and a start volume."""
    rng = np.random.default_rng(5)
    executed = circle(30, Panel(44, 52, 2.0, 2.0))
    source, detector = (
        ends + rng.normal(0, JITTER_MM, ends.shape) for ends in (executed.source, executed.detector)
    )
    believed = replace(executed, source=source, detector=detector)
    head, bones = (ellipsoid_integrals(executed, *body) for body in (HEAD, BONES))
    plain = TISSUE * head + (BONE - TISSUE) * bones
    plain += rng.normal(0, NOISE, plain.shape).astype(np.float32)
    dark = (plain + (METAL - BONE) * integrals(executed, rod(), PLACE)).astype(np.float32)
    A = Projector(believed, VolumeGrid((20, 22, 24), 2.0))
    # Bone where more than bone is seen.
    start = np.minimum(sart(A, dark, iterations=2, relaxation=0.3).array, BONE)
    return A, dark, plain, start


def off(twist):
    return PLACE @ Pose.exp(np.multiply(twist, (1, 1, 1, *[np.pi / 180] * 3)))


def axis_error_deg(pose):
    return np.degrees(np.arccos(np.clip(pose.rotation[:, 2] @ PLACE.rotation[:, 2], -1, 1)))


def found_in(scene, twist=(0, 0, 0, 0, 0, 0), mu=METAL, **keys):
    A, dark, _, start = scene
    implants = [BelievedImplant(rod(), off(twist))]
    keys = {"rounds": 1, "iterations": 2} | keys
    return without_implants(A, OneEnergy(dark, np.array([mu])), implants, start, **keys)


@pytest.mark.parametrize("twist", [(1.2, -1.2, 1.0, 3.5, -3.5, 0), (-1, 0, -1.7, -4, 3, 0)])
def test_a_rod_is_found_from_2_mm_and_5_degrees_off(scene, twist):
    taken = found_in(scene, twist)
    (rod_,) = taken.fitted
    assert rod_.world_from_implant.distance_mm(PLACE) < 0.1
    assert axis_error_deg(rod_.world_from_implant) < 0.2
    sigma = np.sqrt(np.diag(rod_.covariance))
    assert (sigma[:3] < 0.05).all()
    error = (PLACE.inverse() @ rod_.world_from_implant).position
    assert (np.abs(error) < 5 * sigma[:3]).all()
    # METAL stands in bone: it exceeds what is there by this much.
    assert rod_.density == pytest.approx((METAL - BONE) / METAL, abs=0.05)


def test_what_is_left_is_as_good_as_without_metal_though_its_density_is_wrong(scene):
    _, dark, plain, _ = scene
    taken = found_in(scene, (0.5, -0.5, 0.5, 1, 1, 0), mu=METAL * 1.1)
    assert taken.fitted[0].density * 1.1 == pytest.approx((METAL - BONE) / METAL, abs=0.05)
    metal = np.abs(dark - plain) > 1e-3
    error, was = (taken.line_integrals - plain)[metal], (dark - plain)[metal]
    assert np.sqrt((error**2).mean()) < 0.1 * np.sqrt((was**2).mean())
    # Two directions on the panel, source and panel both, seen at half its distance.
    assert 0.03 < np.sqrt((taken.fitted[0].slack ** 2).sum(axis=1).mean()) < 0.2


def test_without_slack_no_view_is_displaced(scene):
    assert not found_in(scene, slack_mm=0).fitted[0].slack.any()


def test_masked_pixels_have_no_influence(scene):
    A, dark, _, start = scene
    mask = np.ones(dark.shape, np.bool_)
    mask[:, :, 23] = mask[3:5, 10:40] = False
    results = [
        without_implants(
            A,
            OneEnergy(np.where(mask, dark, np.float32(value)), np.array([METAL])),
            [BelievedImplant(rod(), off((0.5, 0, 0, 1, 0, 0)))],
            start,
            mask=mask,
            rounds=1,
            iterations=1,
        )
        for value in (9, 1)
    ]
    poses = [one.fitted[0].world_from_implant for one in results]
    assert poses[0].distance_mm(poses[1]) < 1e-6
    np.testing.assert_allclose(*(one.line_integrals[mask] for one in results), atol=1e-6)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"twist": (40, 0, 0, 0, 0, 0)}, "implant 0 extends .* mm beyond the grid"),
        ({"rounds": 0}, "rounds is 0"),
        ({"slack_mm": -1}, "slack_mm is -1"),
    ],
)
def test_what_cannot_be_is_named(scene, keys, words):
    with pytest.raises(InputError, match=words):
        found_in(scene, **keys)


def test_a_view_without_a_free_ray_is_named(scene):
    A, dark, _, start = scene
    mesh = trimesh.creation.box((40, 40, 36))
    small = Panel(4, 4, 2.0, 2.0)
    geometry = replace(A.geometry, panel=small)
    narrow = Projector(geometry, A.grid)
    beam = OneEnergy(np.ones(narrow.range_shape, np.float32), np.array([METAL]))
    implant = BelievedImplant(Body(mesh.vertices, mesh.faces), Pose.identity())
    with pytest.raises(InputError, match="every ray of view 0 passes through an implant"):
        without_implants(narrow, beam, [implant], np.zeros(A.domain_shape))
