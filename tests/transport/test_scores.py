"""Energy and its errors, equal bytes, resumed work, and input that is refused."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numba
import numpy as np
import pytest
import xraylib
from transport_bodies import beam_down, box, view

from twinct.core.errors import InputError
from twinct.geometry import Panel, VolumeGrid
from twinct.specimen.materials import Material, material
from twinct.transport import Beam, Detector, Regions, Scores, Simulation, VoxelBody


def _mixed_body() -> VoxelBody:
    rng = np.random.default_rng(4)
    grid = VolumeGrid((12, 14, 16), 10.0)
    labels = rng.choice(4, grid.shape, p=[0.2, 0.6, 0.15, 0.05])
    names = ("air", "water", "bone", "titanium")
    return VoxelBody.of_labels(grid, labels, {i: material(name) for i, name in enumerate(names)})


def _simulation(**settings) -> Simulation:
    geometry = view((0, 0, 500), (0, 0, -200))
    body = _mixed_body()
    halves = np.indices(body.grid.shape)[0] // 6
    regions = Regions.of_labels(halves, {0: "lower", 1: "upper"})
    beam = beam_down(50.0, [40.0, 100.0], [1.0, 2.0])
    return Simulation(body, beam, regions=regions, detector=Detector(geometry), **settings)


def _bytes(scores: Scores) -> list[bytes]:
    names = ("voxels", "voxels_squared", "images", "images_squared", "regions", "rows", "totals")
    return [getattr(scores, name).tobytes() for name in names]


@contextmanager
def _threads(number: int) -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(min(number, vars(numba.config)["NUMBA_NUM_THREADS"]))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def test_energy_is_conserved_and_scored() -> None:
    """Energy emitted is absorbed or escapes, and voxels and regions hold what is absorbed."""
    scores = _simulation(expected=False).run(5000, 3)
    assert scores.imbalance < 1e-9  # rounding of 5000 sums
    assert scores.voxel_energy()[0].sum() == pytest.approx(scores.absorbed_kev, rel=1e-9)
    assert scores.label_energy()[0].sum() == pytest.approx(scores.absorbed_kev, rel=1e-9)
    regions = scores.region_energy()
    assert sum(mean for mean, _ in regions.values()) == pytest.approx(scores.absorbed_kev)
    assert 0.2 < scores.absorbed_kev / 80.0 < 1


def test_labels_hold_the_energy_of_their_voxels() -> None:
    """The energy of a label is that of its voxels."""
    body = _mixed_body()
    scores = Simulation(body, beam_down(50.0)).run(3000, 2)
    summed = np.bincount(body.codes.ravel(), scores.voxel_energy()[0].ravel())
    np.testing.assert_allclose(scores.label_energy()[0], summed, rtol=1e-9)


def test_a_medium_around_the_grid_attenuates_and_scatters() -> None:
    """Lead around a grid stops the beam before it; air around is like air in a larger grid."""
    beam = beam_down(20.0, 60.0)
    grid = VolumeGrid((4, 4, 4), 20.0)
    labels, water = np.zeros(grid.shape, int), {0: material("water")}
    lead = VoxelBody.of_labels(grid, labels, water, material("lead"))
    scores = Simulation(lead, beam).run(1000, 2)
    assert scores.absorbed_kev == 0
    assert scores.imbalance < 1e-12
    larger = VolumeGrid((52, 12, 12), 20.0)
    inner = np.zeros(larger.shape, int)
    inner[24:28, 4:8, 4:8] = 1
    gas = Material("dense air", 0.03, material("air").mass_fractions)
    around = VoxelBody.of_labels(grid, labels, water, gas)
    within = VoxelBody.of_labels(larger, inner, {0: gas, 1: material("water")})
    geometry = view((0, 0, 500), (0, 0, -520), panel=Panel(2, 2, 10.0, 10.0))
    results, primaries = [], []
    for body, row in ((around, 0), (within, 1)):
        simulation = Simulation(body, beam, dose=False, detector=Detector(geometry))
        primaries.append(simulation.primary(samples=4))
        energy, error = simulation.run(4000, 20, seed=1).label_energy()
        results.append((energy[row], error[row]))
    np.testing.assert_allclose(*primaries, rtol=1e-6)
    (a, da), (b, db) = results
    # Photons that pass beside the grid may return from the gas of the larger grid alone.
    assert a == pytest.approx(b, abs=3 * np.hypot(da, db) + 0.04 * b)


def test_expected_energy_has_the_mean_of_the_energy_that_happens() -> None:
    """Both estimates of the energy agree within their errors; the expected one varies less."""
    analog = _simulation(expected=False).run(5000, 24, seed=1)
    expected = _simulation().run(5000, 24, seed=2)
    other = analog.region_energy()
    for name, (mean, error) in expected.region_energy().items():
        assert abs(mean - other[name][0]) < 3 * np.hypot(error, other[name][1])
    variances = [(s.voxel_energy()[1] ** 2).sum() for s in (analog, expected)]
    assert variances[1] < 0.7 * variances[0]


def test_k_lines_leave_where_their_photons_were_absorbed() -> None:
    """A layer of iodine, thin for its K lines, keeps the rest of the energy, by xraylib."""
    energy, path_mm = 40.0, 1e-3
    grid = VolumeGrid((1, 1, 1), [40.0, 40.0, path_mm])
    iodine = Material("iodine", 1.0, {"I": 1.0})
    body = VoxelBody.of_labels(grid, np.zeros(grid.shape, int), {0: iodine})
    lines = sum(
        xraylib.CS_FluorLine_Kissel(53, line, energy) * xraylib.LineEnergy(53, line)
        for line in (xraylib.KA_LINE, xraylib.KB_LINE)
    )
    whole = xraylib.CS_Photo(53, energy) * energy
    assert lines > 0.4 * whole
    simulation = Simulation(body, beam_down(19.0, energy), oversampling=100.0)
    scores = simulation.run(10_000, 10, seed=1)
    assert scores.imbalance < 1e-12
    # Compton electrons take 1e-4 of it; 0.7 % standard error.
    given = (whole - lines) / 10 * path_mm
    assert scores.label_energy()[0][0] == pytest.approx(given, rel=0.02)


def test_standard_errors_describe_the_scatter_of_seeds() -> None:
    """Regions of independent seeds scatter as their standard errors say."""
    simulation = _simulation()
    runs = [simulation.run(20, 20, seed=s).region_energy()["upper"] for s in range(40)]
    means, errors = np.array(runs).T
    # 40 runs know their deviation within 11 %, 20 batches each mean error within 16 % / sqrt(40).
    assert means.std(ddof=1) == pytest.approx(np.sqrt((errors**2).mean()), rel=0.35)


def test_any_number_of_threads_gives_the_same_bytes() -> None:
    """One and two threads give equal bytes, in rounds of different numbers of batches."""
    results = []
    for number in (1, 2):
        with _threads(number):
            results.append(_bytes(_simulation().run(1000, 5, seed=3)))
    assert results[0] == results[1]


def test_views_seeds_and_batches_have_numbers_of_their_own() -> None:
    """Another seed, view or batch gives other photons."""
    simulation = _simulation()
    runs = [simulation.run(300, 1, seed=s, view=v).totals for s, v in ((0, 0), (1, 0), (0, 1))]
    runs.append(simulation.run(300, 2).totals[1:])
    assert len({run.tobytes() for run in runs}) == 4


class _Stopping:
    """Progress that interrupts the work after some batches."""

    def __init__(self, after: int) -> None:
        self.left = after

    @contextmanager
    def stage(self, name: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
        yield self._step

    def _step(self) -> None:
        self.left -= 1
        if self.left <= 0:
            raise KeyboardInterrupt

    def say(self, text: str, *, warning: bool = False) -> None:
        raise AssertionError(text)


def test_interrupted_work_continues_to_the_same_bytes(tmp_path: Path) -> None:
    """Work that is interrupted keeps its complete batches, and ends with the bytes of one run."""
    kept = tmp_path / "scores.npz"
    whole = _simulation().run(1000, 7, seed=5)
    with pytest.raises(KeyboardInterrupt):
        _simulation().run(1000, 7, seed=5, kept=kept, progress=_Stopping(3))
    with np.load(kept) as stored:
        assert 3 <= len(stored["totals"]) < 7
    resumed = _simulation().run(1000, 7, seed=5, kept=kept)
    assert _bytes(resumed) == _bytes(whole)
    assert _bytes(_simulation().run(1000, 7, seed=5, kept=kept)) == _bytes(whole)
    with pytest.raises(InputError, match="another body, beam, panel, seed"):
        _simulation().run(1000, 7, seed=6, kept=kept)
    kept.write_bytes(b"broken")
    with pytest.raises(InputError, match=r"scores\.npz"):
        _simulation().run(1000, 7, seed=5, kept=kept)


def test_shares_of_densities_absorb_like_one_medium() -> None:
    """Two layers of half the density absorb what one layer of all of it absorbs."""
    water = material("water")
    beam = beam_down(20.0, 50.0, height_mm=1e5)
    energies = []
    for density in (1.0, 0.5):
        grid = VolumeGrid((round(8 / density), 40, 40), [20.0, 20.0, 5.0])
        media, densities = np.zeros(grid.shape, int), np.full(grid.shape, density)
        body = VoxelBody.of_densities(grid, media, densities, [water])
        scores = Simulation(body, beam).run(20_000, 4, seed=1)
        energies.append(scores.absorbed_kev)
        assert body.masses_g().sum() == pytest.approx(800 * 800 * 40 / 1000)
    # The geometry differs sideways only: a scattered photon rarely reaches the sides at 400 mm.
    assert energies[0] == pytest.approx(energies[1], rel=0.01)


def test_mixtures_attenuate_by_the_mass_of_their_materials() -> None:
    """Voxels of air, water and bone in any shares attenuate like their sum, within a step."""
    rng = np.random.default_rng(6)
    grid = VolumeGrid((3, 16, 16), 20.0)
    amounts = rng.dirichlet([1.0, 1.0, 1.0], grid.shape)
    names = ("air", "water", "bone")
    shares = [(material(name), amounts[..., i]) for i, name in enumerate(names)]
    body = VoxelBody.of_shares(grid, shares)
    mass = sum(kind.density_g_cm3 * amount for kind, amount in shares) * 8.0
    np.testing.assert_allclose(body.masses_g(), mass, atol=0.002 * mass.max())
    for energy in (40.0, 100.0):
        mu = sum(kind.mu_per_mm(energy) * amount for kind, amount in shares)
        index = round((energy - 1.0) / 0.05)
        media = body.tables()[1].coefficients[:, index, 0].astype(np.float64)
        own = media[body.palette_media[body.codes]] * body.palette_densities[body.codes]
        # Half a step of 1/16 of the mass changes bone's attenuation at 40 keV by 4 %.
        np.testing.assert_allclose(own, mu, rtol=0.05)
        assert own.mean() == pytest.approx(mu.mean(), rel=3e-3)
    with pytest.raises(InputError, match="needs a material"):
        VoxelBody.of_shares(grid, [])


def test_regions_can_hold_shares_of_voxels() -> None:
    """A region of half of each voxel holds half of the energy."""
    body = box((4, 4, 4), 20.0)
    regions = Regions.of_shares({"all": np.ones((4, 4, 4)), "half": np.full((4, 4, 4), 0.5)})
    energies = Simulation(body, beam_down(20.0), regions=regions).run(1000, 2).region_energy()
    assert energies["half"][0] == pytest.approx(energies["all"][0] / 2)


@pytest.mark.parametrize("energy", [0.5, 150.2, np.nan])
def test_energies_outside_the_tables_are_refused(energy: float) -> None:
    """The message names the energy and the range."""
    with pytest.raises(InputError, match="1 to 150 keV"):
        beam_down(20.0, [60.0, energy], [1.0, 1.0])


def test_beams_that_cannot_be_are_refused() -> None:
    """No photons, a flat or skew field and a source in its plane are named."""
    with pytest.raises(InputError, match="not all 0"):
        beam_down(20.0, [60.0], [0.0])
    with pytest.raises(InputError, match="plane of the field"):
        beam_down(20.0, height_mm=0.0)
    with pytest.raises(InputError, match="orthogonal"):
        Beam((0, 0, 9), (0, 0, 0), (1, 0, 0), (1, 1, 0), 60.0)
    with pytest.raises(InputError, match="three finite numbers"):
        Beam((0, 0, np.inf), (0, 0, 0), (1, 0, 0), (0, 1, 0), 60.0)


def test_bodies_that_cannot_be_are_refused() -> None:
    """Labels without a material, wrong shapes and bad densities are named."""
    grid = VolumeGrid((2, 2, 2), 1.0)
    labels = np.array([0, 3] * 4).reshape(grid.shape)
    with pytest.raises(InputError, match="label 3 has no material"):
        VoxelBody.of_labels(grid, labels, {0: material("air")})
    with pytest.raises(InputError, match=r"shape \(2, 2\)"):
        VoxelBody.of_labels(grid, labels[0], {0: material("air")})
    with pytest.raises(InputError, match="labels from -1"):
        VoxelBody.of_labels(grid, labels - 1, {0: material("air")})
    with pytest.raises(InputError, match="media from 0 to 3"):
        VoxelBody.of_densities(grid, labels, np.ones(grid.shape), [material("air")])
    for bad in (-1.0, np.nan):
        with pytest.raises(InputError, match="density"):
            VoxelBody.of_densities(grid, labels * 0, np.full(grid.shape, bad), [material("air")])
    with pytest.raises(InputError, match="no elements"):
        VoxelBody.of_labels(grid, labels * 0, {0: Material("none", 1.0, {})})


def test_scores_that_cannot_be_are_refused() -> None:
    """Regions of another grid, empty regions, no photons and an absent view are named."""
    body, beam = box((2, 2, 2), 10.0), beam_down(5.0)
    with pytest.raises(InputError, match="grid has the shape"):
        Simulation(body, beam, regions=Regions.of_shares({"a": np.ones((2, 2, 3))}))
    with pytest.raises(InputError, match="need dose"):
        Simulation(body, beam, dose=False, regions=Regions.of_shares({"a": np.ones((2, 2, 2))}))
    with pytest.raises(InputError, match="region lens"):
        Regions.of_labels(np.zeros((2, 2, 2)), {1: "lens"})
    with pytest.raises(InputError, match="at least 1"):
        Simulation(body, beam).run(0, 10)
    with pytest.raises(InputError, match="view 1"):
        Simulation(body, beam, detector=Detector(view((0, 0, 500), (0, 0, -200)), 1))
    with pytest.raises(InputError, match="needs a detector"):
        Simulation(body, beam).primary()


def test_unscattered_and_scattered_energy_add_up() -> None:
    """Energy along rays, and energy after the first collision, are the energy absorbed."""
    body, beam = _mixed_body(), beam_down(50.0, [40.0, 100.0], [1.0, 2.0])
    later = Simulation(body, beam, unscattered=False)
    scores = later.run(4000, 20, seed=2)
    primary = later.primary_energy()
    scattered, error = scores.voxel_energy()
    whole = Simulation(body, beam, expected=False).run(4000, 20, seed=2).absorbed_kev
    assert primary.sum() + scattered.sum() == pytest.approx(whole, rel=0.01)
    assert 0.3 < primary.sum() / whole < 0.9
    alone = later.primary_energy(np.array([5, 700]))
    np.testing.assert_allclose(alone, primary.ravel()[[5, 700]])


def test_unscattered_energy_is_that_of_the_coefficients() -> None:
    """In a column of water: fluence times E mu_en / rho of a table, behind 95 mm."""
    body = box((20, 1, 1), (10.0, 10.0, 10.0))
    simulation = Simulation(body, beam_down(2.0, 60.0, height_mm=1000.0), unscattered=False)
    energy = simulation.primary_energy()[10, 0, 0]
    water = material("water")
    area = 16.0 / 1000.0**2 * 995.0**2  # of the field, at the middle of the voxel
    mass_mg = 10.0 * area  # of the water in the field
    # J. H. Hubbell, S. M. Seltzer, NISTIR 5632: 0.03190 cm^2/g.
    kerma = 60 * 0.0319 * 0.1 * np.exp(-95 * water.mu_per_mm(60.0)) / area
    assert energy == pytest.approx(kerma * mass_mg, rel=0.015)


def test_a_soft_line_gives_a_thick_voxel_all_of_its_energy() -> None:
    """Its exponent, 840 up to the middle of the voxel, is beyond the largest float."""
    body = box((1, 1, 1), (10.0, 10.0, 400.0))
    energy = Simulation(body, beam_down(2.0, 5.0, height_mm=1000.0)).primary_energy()[0, 0, 0]
    assert energy == pytest.approx(5.0, rel=0.03)  # keV of a photon


def test_voxels_at_the_edge_of_a_field_count_by_their_share() -> None:
    """A field that is narrower than coarse voxels gives them the energy of fine ones."""
    beam = beam_down(3.3, [60.0], height_mm=300.0)
    coarse, fine = (
        Simulation(box(shape, (60 / shape[2], 60 / shape[1], 10.0)), beam, unscattered=False)
        for shape in ((6, 6, 6), (6, 300, 300))
    )
    expected = fine.primary_energy().reshape(6, 6, 50, 6, 50).sum(axis=(2, 4))
    found = coarse.primary_energy()
    assert (found > 0).sum() == 24
    np.testing.assert_allclose(found.sum(axis=(1, 2)), expected.sum(axis=(1, 2)), rtol=0.015)
    # At the field's corners, 200 of 2048 points count, more even than by chance.
    np.testing.assert_allclose(found, expected, rtol=0.08)


def test_unscattered_energy_cannot_be_told_from_collisions() -> None:
    """The energy that a collision deposits is of both kinds."""
    with pytest.raises(InputError, match="needs expected=True"):
        Simulation(_mixed_body(), beam_down(50.0), expected=False, unscattered=False)
