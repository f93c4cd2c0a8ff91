"""Metal as a scenario has it reduced: put back, gone on with, refused; without metal nothing."""

import numpy as np
import pytest
from still_scans import chords, still_scan, views_of

from twinct.core.errors import InputError
from twinct.observers import Observer, Said
from twinct.recon import Projector, sart, without_metal
from twinct.runs import line_integrals, reconstruct
from twinct.runs.metal_reduction import check_metal
from twinct.runs.volumes import memory_needed
from twinct.scenario import parse_scenario
from twinct.specimen import material

TISSUE, METAL = 0.02, 0.2
NMAR = {"method": "nmar", "metal": "titanium", "first_iterations": 2}


def settings(**reconstruction):
    grid = {"voxels": 24, "voxel_mm": 4.0}
    return parse_scenario(
        {
            "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8.0},
            "trajectory": {"kind": "circle", "views": 16},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 35}}]},
            "uncertainty": {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}},
            "reconstruction": {"grid": grid, "iterations": 3} | reconstruction,
        }
    )


@pytest.fixture
def scan():
    """A ball of tissue with a ball of metal in its middle, or without, in numbers."""

    def make(metal_mm=9.0, **reconstruction):
        scenario = settings(**reconstruction)
        geometry = views_of(scenario)
        images = np.zeros((len(geometry), *geometry.panel.shape), np.float32)
        for view, image in enumerate(images):
            of_tissue, of_metal = chords(geometry, view, 35.0, metal_mm)
            image += TISSUE * of_tissue
            image += METAL * of_metal
        return still_scan(scenario, np.exp(-images))

    return make


def test_line_integrals_are_replaced_and_metal_is_put_back(scan):
    given = scan(metal=NMAR)
    panel, section = given.scenario.detector.panel, given.scenario.reconstruction
    A = Projector(given.believed.geometry(panel), section.grid.volume_grid)
    names = {"tissue": "soft_tissue", "bone": "bone", "metal": "titanium"}
    mus = {name: material(of).mu_per_mm(80.0) for name, of in names.items()}
    rest = without_metal(A, line_integrals(given.transmission), **mus, first_iterations=2)
    assert 8 < rest.voxels.size < 150
    volume = sart(A, rest.line_integrals, iterations=3, relaxation=0.3)
    assert np.array_equal(reconstruct(given).array, rest.put_back(volume).array)


def test_without_metal_no_bit_changes(scan):
    heard = []
    listens = Observer(heard.append, lossless=True)
    found = reconstruct(scan(metal_mm=0, metal=NMAR), observers=[listens])
    assert np.array_equal(found.array, reconstruct(scan(metal_mm=0)).array)
    assert found.extras["metal_voxels"] == 0
    (told,) = (one.text for one in heard if isinstance(one, Said))
    assert found.extras["warnings"] == [told]
    assert "reconstruction.metal: no metal was found" in told and "threshold_per_mm" in told


def test_what_leaves_no_ray_is_told_with_its_key(scan):
    middle = np.zeros((30, 40), np.bool_)  # no ray that misses the grid
    middle[12:18, 16:24] = True
    words = "^reconstruction.metal: every ray of 16 of 16 views .* the threshold of 1e-09 per mm"
    with pytest.raises(InputError, match=words):
        reconstruct(scan(metal=NMAR | {"threshold_per_mm": 1e-9}), mask=middle)


def test_a_reconstruction_goes_on_and_is_found_finished(scan, tmp_path):
    whole = reconstruct(scan(metal=NMAR)).array
    reconstruct(scan(metal=NMAR), checkpoints=tmp_path)
    heard = []
    again = reconstruct(
        scan(metal=NMAR), checkpoints=tmp_path, watch=lambda number, _: heard.append(number)
    )
    assert heard == [1, 2, 3]  # from the checkpoint
    assert np.array_equal(again.array, whole)


def test_its_memory_is_told(scan):
    given = scan()
    views = given.commanded.geometry(given.scenario.detector.panel)
    plain, reduced = (memory_needed(settings(**keys), views) for keys in ({}, {"metal": NMAR}))
    assert set(reduced) - set(plain) == {"metal"}
    assert reduced["metal"] > plain["sart"] + 4 * 24**3


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"metal": "titanum"}, "reconstruction.metal.metal: unknown material 'titanum'"),
        ({"bone": "water"}, r"reconstruction.metal: attenuation must rise .* bone 0.0184"),
    ],
)
def test_what_cannot_be_is_refused_before_any_work(keys, words):
    with pytest.raises(InputError, match=words):
        check_metal(settings(metal=NMAR | keys))
