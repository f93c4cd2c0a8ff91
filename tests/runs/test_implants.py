"""Known implants as a scenario names them: found, put back, gone on with, refused."""

import numpy as np
import pytest
from still_scans import chords, still_scan, views_of

from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.rays import Rays
from twinct.recon.known_components import FittedImplant
from twinct.runs import reconstruct, require_feasible
from twinct.runs.implants import ScanWithoutImplants, check_implants, known_implants
from twinct.runs.volumes import memory_needed
from twinct.scenario import parse_scenario
from twinct.specimen import material
from twinct.trajectory import commanded_views

TISSUE = 0.02
SCREW = {
    "name": "screw",
    "shape": {"kind": "cylinder", "radius_mm": 3, "height_mm": 30},
    "material": "titanium",
    "position_mm": [6, 3, -2],
    "rotation_deg": [70, 10, 30],
}
BELIEVED = {"part": "screw", "position_mm": [7, 2, -1], "rotation_deg": [72, 11, 30]}
KNOWN = {"method": "known", "implants": [BELIEVED], "first_iterations": 2, "rounds": 1}


def settings(**reconstruction):
    grid = {"voxels": 24, "voxel_mm": 4.0}
    return parse_scenario(
        {
            "detector": {"columns": 48, "rows": 40, "pixel_pitch_mm": 4.0},
            "trajectory": {"kind": "circle", "views": 16},
            "specimen": {
                "parts": [
                    {"shape": {"kind": "sphere", "radius_mm": 35}, "material": "soft_tissue"},
                    SCREW,
                ]
            },
            "uncertainty": {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}},
            "reconstruction": {"grid": grid, "iterations": 3} | reconstruction,
        }
    )


@pytest.fixture
def scan():
    """A ball of tissue with a screw in it, in numbers."""

    def make(**reconstruction):
        scenario = settings(**reconstruction)
        geometry = views_of(scenario)
        images = np.zeros((len(geometry), *geometry.panel.shape), np.float32)
        section = {"method": "known", "implants": [{"part": "screw"}]}
        (screw,) = known_implants(scenario, settings(metal=section).reconstruction.metal)
        body, pose = screw.implant.body, screw.implant.world_from_implant
        rays = Rays(geometry)
        for view, image in enumerate(images):
            image += TISSUE * chords(geometry, view, 35.0)[0]
            box, lengths, _ = rays.shadow(body, pose, view)
            image[box] += (screw.material.mu_per_mm(80.0) - TISSUE) * lengths
        return still_scan(scenario, np.exp(-images))

    return make


def test_an_implant_is_found_and_put_back(scan):
    volume = reconstruct(scan(metal=KNOWN))
    (found,) = volume.extras["implants"]
    assert found["name"] == "screw"
    np.testing.assert_allclose(found["position_mm"], SCREW["position_mm"], atol=0.1)
    pose = Pose.from_euler(found["position_mm"], found["rotation_deg"])
    axes = pose.rotation[:, 2], Pose.from_euler((0, 0, 0), SCREW["rotation_deg"]).rotation[:, 2]
    assert np.degrees(np.arccos(min(axes[0] @ axes[1], 1))) < 0.2
    assert found["moved_mm"] == pytest.approx(np.sqrt(3), abs=0.1)
    mu = material("titanium").mu_per_mm(80.0)
    assert 0.5 * mu < volume.array.max() <= mu * (1 + 1e-6)
    # The screw's own volume is in the voxels, beside that of the ball.
    metal = volume.array[volume.array > 3 * TISSUE].sum() * 4**3
    assert metal == pytest.approx(mu * np.pi * 9 * 30, rel=0.2)


def test_standard_deviations_of_positions_are_along_the_specimens_axes():
    turned = dict(BELIEVED, rotation_deg=[0, 0, 90])
    scenario = settings(metal=KNOWN | {"implants": [turned]})
    known = known_implants(scenario, scenario.reconstruction.metal)
    own = np.diag(np.square([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]))
    found = FittedImplant(known[0].implant.world_from_implant, own, 1.0, np.zeros((2, 3)))
    stands = Pose.from_euler((1, 2, 3), (0, 0, 90))
    for of, expected in ((Pose.identity(), [0.2, 0.1, 0.3]), (stands, [0.1, 0.2, 0.3])):
        (told,) = ScanWithoutImplants(np.empty(0, np.float32), known, [found], of, 80.0).results()
        np.testing.assert_allclose(told["position_sigma_mm"], expected, atol=1e-12)
        np.testing.assert_allclose(np.radians(told["rotation_sigma_deg"]), [0.01, 0.02, 0.03])


def test_a_reconstruction_goes_on_and_is_found_finished(scan, tmp_path):
    whole = reconstruct(scan(metal=KNOWN), checkpoints=tmp_path)
    again = reconstruct(scan(metal=KNOWN), checkpoints=tmp_path)
    assert np.array_equal(again.array, whole.array)
    assert again.extras["implants"] == whole.extras["implants"]


def test_its_memory_is_told():
    scenarios = settings(), settings(metal=KNOWN)
    views = commanded_views(scenarios[0].trajectory, scenarios[0].detector.panel)
    plain, known = (memory_needed(one, views) for one in scenarios)
    assert set(known) - set(plain) == {"metal", "implants"}
    assert known["implants"] > plain["sart"] + 4 * 2 * 24**3


@pytest.mark.parametrize(
    ("implant", "words"),
    [
        ({"part": "nail"}, r"reconstruction.metal.implants.0.part: no part is called 'nail'"),
        ({"part": "screw", "position_mm": [45, 0, 0]}, r"screw extends .* mm beyond the grid"),
        ({"part": "screw", "material": "titanum"}, r"implants.0.material: unknown .* 'titanum'"),
        ({"part": "screw", "material": "water"}, r"screw of water attenuates .* must exceed bone"),
        (
            {"part": "screw", "shape": {"kind": "box", "size_mm": [90, 90, 90]}},
            r"every ray of view 0 passes through an implant",
        ),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(implant, words):
    section = {"method": "known", "implants": [implant]}
    scenario = settings(metal=section)
    if "shape" in implant:
        told = scenario.model_dump(mode="json")
        told["detector"] |= {"columns": 4, "rows": 4}
        told["reconstruction"]["grid"]["voxels"] = 40
        scenario = parse_scenario(told)
    views = commanded_views(scenario.trajectory, scenario.detector.panel)
    with pytest.raises(InputError, match=words):
        check_implants(scenario, scenario.reconstruction.metal, views)
    with pytest.raises(InputError, match=words):
        require_feasible(scenario, views)


def test_an_implant_without_a_part_is_described_in_full():
    with pytest.raises(InputError, match="give part, or all of shape, material"):
        settings(metal={"method": "known", "implants": [{"material": "titanium"}]})
    whole = {key: value for key, value in SCREW.items() if key not in ("name", "rotation_deg")}
    scenario = settings(metal={"method": "known", "implants": [whole]})
    (one,) = known_implants(scenario, scenario.reconstruction.metal)
    assert one.name == "implant 0"
