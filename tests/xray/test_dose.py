"""Dose of views: energy, units, places, and the figures that a C-arm reports."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, ScanGeometry
from twinct.scenario import Specimen
from twinct.specimen import BuiltSpecimen, build_specimen
from twinct.trajectory import CircleTrajectory, commanded_views
from twinct.transport import Beam, Simulation
from twinct.xray.beam_shape import BeamShape
from twinct.xray.dose import (
    PlaceDoses,
    effective_dose,
    kerma_area_product_gy_cm2,
    reference_kerma_gy,
)
from twinct.xray.dose.effective_dose import WEIGHTS
from twinct.xray.spectrum import PhotonSpectrum
from twinct.xray.voxel_specimen import grid_of, in_voxels

SPECTRUM = PhotonSpectrum([40.0, 80.0], [1e6, 2e6])
GY_PER_KEV_G = 1.602176634e-13


def _circle(views: int, panel: Panel | None = None, sdd_mm: float = 1000) -> ScanGeometry:
    circle = CircleTrajectory(kind="circle", views=views, sod_mm=600, sdd_mm=sdd_mm)
    return commanded_views(circle, panel or Panel(20, 24, 12.0, 12.0))


def _balls() -> BuiltSpecimen:
    """A ball of water with a ball of bone beside its middle."""
    parts = [
        {"name": "water", "shape": {"kind": "sphere", "radius_mm": 50}, "material": "water"},
        {
            "name": "bone",
            "shape": {"kind": "sphere", "radius_mm": 12},
            "material": "bone",
            "position_mm": [20, 0, 0],
        },
    ]
    place = {"position_mm": [5, -3, 2], "rotation_deg": [0, 0, 30]}
    return build_specimen(Specimen.model_validate({"parts": parts, **place}))


def test_dose_of_a_path_is_the_energy_that_photons_leave() -> None:
    """Masses times doses add up to what all photons deposit, as the collisions have it."""
    specimen, views = _balls(), _circle(3)
    places = PlaceDoses(specimen, BeamShape(SPECTRUM), ["water", "bone"], 4.0, "voxel_mm")
    mas = np.array([1.0, 2.0, 4.0])
    path = places.of_path(views, mas, 20_000, seed=1)
    body = in_voxels(specimen, grid_of(specimen, 4.0, "voxel_mm"))
    seen = specimen.world_from_specimen.inverse() @ views
    joules = 0.0
    for view, load in enumerate(mas.tolist()):
        beam = Beam.of_view(seen, view, SPECTRUM.energies_kev, SPECTRUM.photons)
        photons = 3e6 * load * beam.solid_angle * 1000.0**2
        kept = Simulation(body, beam, dose=False, expected=False).run(4000, 5, seed=9, view=view)
        joules += photons * kept.absorbed_kev * GY_PER_KEV_G
    masses = body.masses_g()
    assert (path.voxels * masses).sum() == pytest.approx(joules, rel=0.015)
    assert path.doses @ path.masses_g == pytest.approx(joules, rel=0.015)
    assert path.masses_g == pytest.approx([1000 * 0.5236 - 7.24, 7.24 * 1.92], rel=0.03)


def test_errors_are_those_of_other_seeds() -> None:
    """Doses of ten seeds spread as their standard errors say."""
    places = PlaceDoses(_balls(), BeamShape(SPECTRUM), ["bone"], 5.0, "voxel_mm")
    found = [places.scattered(_circle(4), 2000, seed=seed) for seed in range(10)]
    doses, errors = (np.array([one[n] for one in found]) for n in range(2))
    own = np.sqrt((errors**2).mean())
    # 40 values about 4 means: the spread is known within 12 %, and the errors within 3 %.
    assert 0.65 < doses.std(axis=0, ddof=1).mean() / own < 1.35
    assert np.isfinite(doses).all()


def test_unscattered_dose_by_few_rays_is_that_of_all() -> None:
    """Rays to some voxels of a place have the mean of the rays to all."""
    places, views = (
        PlaceDoses(_balls(), BeamShape(SPECTRUM), ["water", "bone"], 2.5, "voxel_mm"),
        _circle(3),
    )
    few = places.unscattered(views).sum(axis=0)
    path = places.of_path(views, np.ones(3), 80)
    assert few == pytest.approx(path.unscattered, rel=0.01)


def test_a_thin_sheet_gets_fluence_times_absorption() -> None:
    """1 mm of water in free air: photons per area times E mu_en / rho of a table."""
    shape = {"kind": "box", "size_mm": [1, 40, 40]}
    sheet = {"name": "sheet", "shape": shape, "material": "water"}
    specimen = build_specimen(Specimen.model_validate({"parts": [sheet]}))
    places = PlaceDoses(
        specimen, BeamShape(PhotonSpectrum([60.0], [1e6])), ["sheet"], 1.0, "voxel_mm"
    )
    source, panel, u, v = np.array(
        [[[-600, 0, 0]], [[400, 0, 0]], [[0, -1, 0]], [[0, 0, 1]]], float
    )
    (dose,) = places.unscattered(ScanGeometry(source, panel, u, v, Panel(8, 8, 30.0, 30.0)))[0]
    # J. H. Hubbell, S. M. Seltzer, NISTIR 5632: 0.03190 cm^2/g; half a mm of water lies before.
    per_g = 1e6 * (1000 / 600) ** 2 * 60 * 0.0319 * 100 * np.exp(-0.0103)
    assert dose == pytest.approx(per_g * GY_PER_KEV_G, rel=0.015)


def test_reference_point_and_area_product() -> None:
    """Air kerma by a table and the inverse square, 150 mm before the isocentre."""
    views, one = _circle(2), PhotonSpectrum([60.0], [1e6])
    # J. H. Hubbell, S. M. Seltzer, NISTIR 5632: 0.03041 cm^2/g of air.
    at_1_m = 1e6 * 60 * 0.03041 * 100 * GY_PER_KEV_G
    assert reference_kerma_gy(BeamShape(one), views, (0, 0, 0)) == pytest.approx(
        at_1_m / 0.45**2, rel=0.015
    )
    small = _circle(2, Panel(2, 2, 10.0, 10.0))
    product = kerma_area_product_gy_cm2(BeamShape(one), small)
    assert product == pytest.approx(at_1_m * 2.0**2, rel=0.015)
    # A panel at half the distance and of half the size has the same field.
    near, far = (
        _circle(1, Panel(20, 24, 6.0, 6.0), 700),
        _circle(1, Panel(20, 24, 12.0, 12.0), 1400),
    )
    assert kerma_area_product_gy_cm2(BeamShape(one), near) == pytest.approx(
        kerma_area_product_gy_cm2(BeamShape(one), far), rel=1e-9
    )
    assert np.isnan(reference_kerma_gy(BeamShape(one), views, views.source[0])[0])


def test_effective_dose_needs_every_tissue() -> None:
    """Equal doses to all tissues are the effective dose; without one there is none."""
    assert sum(WEIGHTS.values()) == pytest.approx(1.0)
    names = [name.split("|")[0] for name in WEIGHTS]
    every = {f"left_{name}s" if name == "lung" else name: (2.0, 0.1, 5.0) for name in names}
    whole = effective_dose(every)
    assert (whole.sievert, whole.error) == (pytest.approx(2.0), pytest.approx(0.1))
    # The right lung of three times the mass: (1 x 2 + 3 x 4) / 4.
    more = effective_dose({**every, "right lung": (4.0, 0.1, 15.0)})
    assert more.sievert == pytest.approx(2.0 + 0.12 * 1.5)
    del every["thyroid"]
    assert effective_dose(every).sievert is None
    assert effective_dose(every).missing == ("thyroid",)


def test_what_has_no_dose_is_named() -> None:
    """Unknown names, energies above the tables, and sources without a photon number."""
    with pytest.raises(InputError, match="no part or label is called 'eye'"):
        PlaceDoses(_balls(), BeamShape(SPECTRUM), ["eye"], 5.0, "voxel_mm")
    with pytest.raises(InputError, match="photons of 200 keV"):
        PlaceDoses(_balls(), BeamShape(PhotonSpectrum([200.0], [1.0])), ["bone"], 5.0, "voxel_mm")
    with pytest.raises(InputError, match=r"needs a photon number: set source\.photons"):
        PlaceDoses(
            _balls(), BeamShape(PhotonSpectrum([60.0], [1.0], False)), ["bone"], 5.0, "voxel_mm"
        )


def test_points_beside_the_panel_get_no_unscattered_dose() -> None:
    """A ball of which the panel shows one half: the other half is out of the beam."""
    half = Panel(20, 12, 12.0, 12.0)
    views = _circle(1)
    beside = ScanGeometry(views.source, views.detector + 72.0 * views.u, views.u, views.v, half)
    ball = {"name": "ball", "shape": {"kind": "sphere", "radius_mm": 40}, "material": "water"}
    specimen = build_specimen(Specimen.model_validate({"parts": [ball]}))
    places = PlaceDoses(
        specimen, BeamShape(SPECTRUM), ["ball"], 4.1, "voxel_mm"
    )  # 20 voxels: none on the edge
    whole, part = places.unscattered(views)[0, 0], places.unscattered(beside)[0, 0]
    assert part == pytest.approx(whole / 2, rel=0.05)
    assert places.scattered(beside, 5000)[0][0, 0] > 0.1 * part
