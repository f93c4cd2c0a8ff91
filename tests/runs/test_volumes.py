"""From a scan to a volume: masks, checkpoints and memory, on projections without robots."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from still_scans import chords, still_scan, views_of
from waiting import HANG_S

from twinct.core import card
from twinct.core.errors import InputError, MemoryShortageError
from twinct.geometry import ScanGeometry
from twinct.observers import IterationDone, Observer, StageEnded, StageStep, audience
from twinct.recon import Projector, memory
from twinct.recon.stopping import PROJECTIONS, VOLUMES
from twinct.recon.unexplained import Unexplained, unexplained
from twinct.runs import (
    line_integrals,
    reconstruct,
    require_extras,
    require_feasible,
    volumes,
)
from twinct.runs.checkpoints import Follower
from twinct.runs.integrals import hardening_corrected
from twinct.runs.model_doubts import leaves_much
from twinct.runs.volumes import memory_needed
from twinct.scenario import load_scenario, parse_scenario, stage_digests
from twinct.trajectory import commanded_views

TWO = {"kind": "two_materials", "base": "water", "dense": "bone", "first_iterations": 2}
AROUND = {"margin_mm": 20, "voxel_mm": 10, "iterations": 1}
MU = 0.03


def settings(noise=None, **reconstruction):
    grid = {"voxels": 24, "voxel_mm": 5.0}
    passes = {} if "passes" in reconstruction else {"iterations": 3}
    return parse_scenario(
        {
            "source": {"spectrum": {"kind": "tube", "kvp": 80}},
            "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8.0, "noise": noise},
            "trajectory": {"kind": "circle", "views": 12},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 40}}]},
            "uncertainty": {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}},
            "reconstruction": {"grid": grid} | passes | reconstruction,
        }
    )


@pytest.fixture
def scan():
    """A ball, in numbers: three geometries alike."""

    def make(radius_mm=40.0, **reconstruction):
        scenario = settings(**reconstruction)
        geometry = views_of(scenario)
        images = np.empty((len(geometry), *geometry.panel.shape), np.float32)
        for view, image in enumerate(images):
            image[:] = np.exp(-MU * chords(geometry, view, radius_mm)[0])
        return still_scan(scenario, images)

    return make


def test_views_of_more_mas_count_for_more(scan):
    """Three views of twelve are wrong; with a ten-thousandth of the mAs they do little harm."""
    good = scan(noise={"kind": "quantum"}, algorithm="fista_tv", passes=10)
    spoilt, mas = good.transmission.copy(), np.full(len(good), good.scenario.source.mas)
    spoilt[::4], mas[::4] = 0.5, 1e-4 * mas[0]
    bad, truth = replace(good, transmission=spoilt), reconstruct(good).array

    def off(one):
        return np.sqrt(np.mean((reconstruct(one).array - truth) ** 2))

    # Without these views what is left is the streaks of nine.
    assert off(replace(bad, mas=mas)) < 0.4 * off(bad)


def masked(scan):
    """A mask, and the scan with NaN where it is False."""
    mask = np.ones(scan.transmission.shape[1:], np.bool_)
    mask[:, 17] = False
    mask[20, 3:9] = False
    return mask, replace(scan, transmission=np.where(mask, scan.transmission, np.float32(np.nan)))


def test_an_algorithm_that_knows_no_mask_refuses_it_by_name(scan):
    mask, broken = masked(scan(algorithm="rtk_sart"))
    with pytest.raises(InputError, match="rtk_sart takes no mask"):
        reconstruct(broken, mask=mask)


@pytest.mark.parametrize("kind", [{"kind": "one_material"}, TWO], ids=["one", "two"])
def test_hardening_leaves_masked_pixels_out(scan, kind):
    whole = scan(beam_hardening=kind)
    mask, broken = masked(whole)
    volume = reconstruct(broken, mask=mask)
    assert np.isfinite(volume.array).all()
    other = replace(broken, transmission=np.where(mask, whole.transmission, np.float32(0.9)))
    np.testing.assert_array_equal(volume, reconstruct(other, mask=mask))


def killed_after(number):
    def watch(done, _):
        if done == number:
            raise KeyboardInterrupt

    return watch


def test_checkpoints_of_other_projections_or_masks_are_left_alone(scan, tmp_path):
    first = scan()
    mask, _ = masked(first)
    for other, keys in ((first, {"mask": mask}), (scan(radius_mm=30.0), {}), (first, {})):
        expected = reconstruct(other, **keys)
        with pytest.raises(KeyboardInterrupt):
            reconstruct(other, checkpoints=tmp_path, watch=killed_after(1), **keys)
        np.testing.assert_array_equal(reconstruct(other, checkpoints=tmp_path, **keys), expected)
    assert len({path.name.rpartition("-")[0] for path in tmp_path.iterdir()}) == 3


def test_a_finished_checkpoint_is_found_before_any_work(scan, tmp_path, monkeypatch):
    done = scan(beam_hardening=TWO, surroundings=AROUND)
    volume = reconstruct(done, checkpoints=tmp_path)

    def work(*_, **__):
        raise AssertionError("worked again")

    for name in ("hardening_corrected", "without_surroundings", "Projector"):
        monkeypatch.setattr(volumes, name, work)
    residuals = []
    again = reconstruct(done, checkpoints=tmp_path, watch=lambda *step: residuals.append(step))
    np.testing.assert_array_equal(again, volume)
    assert again.grid == volume.grid
    assert [number for number, _ in residuals] == [1, 2, 3]


def test_memory_is_told_for_each_stage(scan):
    views = scan().commanded.geometry(settings().detector.panel)
    voxels, pixels = 24**3, 12 * 40 * 30
    plain = memory_needed(settings(), views)
    held = 8 * pixels + 5 * voxels + memory.SPARE_BYTES
    assert plain == {"sart": held + 4 * voxels}
    all_of_it = memory_needed(
        settings(beam_hardening=TWO, surroundings=AROUND, algorithm="cgls"), views
    )
    assert list(all_of_it) == ["beam hardening", "surroundings", "cgls"]
    assert all_of_it["beam hardening"] == held + 8 * voxels + 4 * pixels
    assert all_of_it["cgls"] == held + 12 * voxels + 9 * pixels


def test_two_materials_that_do_not_fit_are_refused_before_work(scan, monkeypatch):
    views = scan().commanded.geometry(settings().detector.panel)
    limit = max(memory_needed(settings(), views).values())
    monkeypatch.setattr(memory, "available_bytes", lambda: (limit, "a limit"))
    require_feasible(settings(), views)
    with pytest.raises(MemoryShortageError, match="beam hardening with a grid of .24, 24, 24. vox"):
        require_feasible(settings(beam_hardening=TWO), views)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"surroundings": {"margin_mm": 900, "voxel_mm": 20}}, "surroundings: with margin_mm 900"),
        ({"algorithm": "fast", "levels": 2, "margin": 2}, r"margin: with a margin of 2 .720 mm."),
    ],
)
def test_what_reaches_behind_a_source_is_refused_before_any_work(keys, words):
    told = settings().model_dump(mode="json")
    told["reconstruction"] = {"grid": {"voxels": 24, "voxel_mm": 15.0}} | keys
    scenario = parse_scenario(told)
    views = commanded_views(scenario.trajectory, scenario.detector.panel)
    with pytest.raises(InputError, match=f"^reconstruction.{words}.* behind the source of view"):
        require_feasible(scenario, views)


@pytest.mark.parametrize("kind", [{"kind": "one_material"}, TWO], ids=["one", "two"])
@pytest.mark.parametrize("large", ["volume", "projections"])
def test_hardening_takes_what_is_told(scan, kind, large):
    given = scan(beam_hardening=kind)
    grid, views = {"volume": (80, 3), "projections": (8, 12)}[large]
    given = scan(beam_hardening=kind, grid={"voxels": grid, "voxel_mm": 100 / grid})
    scenario = given.scenario
    geometry = given.commanded.geometry(scenario.detector.panel)[:views]
    p = line_integrals(given.transmission[:views])
    if large == "projections":
        p, geometry = np.tile(p, (8, 1, 1)), geometry[np.arange(8 * views) % views]
    A = Projector(geometry, scenario.reconstruction.grid.volume_grid)
    hardening_corrected(scenario, p, A)  # tables, imports
    tracemalloc.start()
    try:
        hardening_corrected(scenario, p, A)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    section = scenario.reconstruction.beam_hardening
    told = volumes.hardening_bytes(section, grid**3, p.size)
    assert peak < told
    # Half of the spare bytes would hide a volume or the projections: they are larger here.
    needed = told - memory.SPARE_BYTES
    assert peak > 0.6 * needed


def test_an_engine_that_is_none_is_refused_before_any_work(monkeypatch):
    scenario = settings()
    views = commanded_views(scenario.trajectory, scenario.detector.panel)
    require_feasible(scenario, views)
    monkeypatch.setenv("TWINCT_ENGINE", "fast")
    with pytest.raises(
        InputError, match="TWINCT_ENGINE is 'fast'; it must be vector, plain or cuda"
    ):
        require_feasible(scenario, views)


def test_a_card_that_is_not_there_is_named_before_any_work(scan, monkeypatch):
    monkeypatch.setattr(card.warp(), "get_devices", lambda: ["cpu"])
    monkeypatch.delenv(card.DEVICE_VARIABLE, raising=False)
    views = scan().commanded.geometry(settings().detector.panel)
    monkeypatch.setenv("TWINCT_ENGINE", "cuda")
    with pytest.raises(InputError, match="no CUDA card or driver"):
        require_feasible(settings(), views)
    monkeypatch.delenv("TWINCT_ENGINE")
    with pytest.raises(InputError, match="no CUDA card or driver"):
        require_extras(load_scenario("demo", {"xray.engine": "cuda_mesh"}))


def with_edges(scan):
    """Passes of a ball in voxels of 5 mm, which soon have nothing left to gain."""
    return scan(stop="auto", iterations=12, relaxation=1.0)


def test_stopping_goes_on_from_any_pass_to_the_last_bit(scan, tmp_path):
    one, told = with_edges(scan), []
    whole = reconstruct(one, watch=lambda *step: told.append(step))
    passes = whole.extras["passes"]
    assert 1 < passes < 12
    assert [number for number, _ in told] == list(range(1, passes + 1))
    for number in range(1, passes + 1):
        folder, again = tmp_path / str(number), []
        with pytest.raises(KeyboardInterrupt):
            reconstruct(one, checkpoints=folder, watch=killed_after(number))
        rest = reconstruct(one, checkpoints=folder, watch=lambda *step, to=again: to.append(step))
        np.testing.assert_array_equal(rest, whole)
        assert rest.extras["passes"] == passes
        assert again == told


def test_all_passes_are_told_where_none_is_too_many(scan, tmp_path):
    one = scan(stop="auto", iterations=2, relaxation=0.1)
    for _ in range(2):  # the second finds the checkpoint
        assert reconstruct(one, checkpoints=tmp_path).extras["passes"] == 2


def test_progress_ends_at_its_total_though_there_are_fewer_levels(scan, monkeypatch):
    heard = []
    monkeypatch.setattr(audience, "LAST_WORDS_S", HANG_S)
    reconstruct(scan(), algorithm="fast", levels=3, observers=[heard.append])
    (ended,) = (event for event in heard if isinstance(event, StageEnded))
    assert ended.done == ended.total == 12 * (4 + 2 + 1) + 4 * 2


def test_progress_ends_at_its_total_though_there_are_more_passes(scan, monkeypatch):
    """Four passes of two subsets, each of six views, are expected at full resolution."""
    heard = []
    monkeypatch.setattr(audience, "LAST_WORDS_S", HANG_S)
    fine = scan(grid={"voxels": 48, "voxel_mm": 2.5})
    reconstruct(fine, algorithm="fast", levels=1, observers=[heard.append])
    (ended,) = (event for event in heard if isinstance(event, StageEnded))
    assert ended.done == ended.total == 12 + 4 * 2


def test_progress_counts_the_updates_of_fast_that_show_the_best_pass(scan, monkeypatch):
    heard, prepared = [], []
    prepare = Follower.prepare
    monkeypatch.setattr(
        Follower, "prepare", lambda self, step: prepared.append(step) or prepare(self, step)
    )
    stops = scan(stop="auto", iterations=2, relaxation=0.1)
    reconstruct(stops, observers=[Observer(heard.append, lossless=True)])
    first = next(n for n, event in enumerate(heard) if isinstance(event, IterationDone))
    steps = [event.done for event in heard[:first] if isinstance(event, StageStep)]
    expected = 12 * (4 + 2 + 1) + 4 * 2
    assert len(prepared) > 12
    assert steps[-1] == expected + 12
    (ended,) = (event for event in heard if isinstance(event, StageEnded))
    assert ended.done == ended.total == expected + 2 * 12


def test_stopping_takes_memory_for_the_volumes_of_fast_and_of_the_pass_before(scan):
    views = scan().commanded.geometry(settings().detector.panel)
    plain, stopping = memory_needed(settings(), views), memory_needed(settings(stop="auto"), views)
    more = VOLUMES * 24**3 + PROJECTIONS * len(views) * math.prod(views.panel.shape)
    assert stopping["sart"] - plain["sart"] == pytest.approx(4 * more, abs=1)


def test_a_volume_of_before_is_still_that_of_its_scenario():
    """The new key at its default changes no digest; another value does."""
    digests = [stage_digests(settings(**keys))["volume"] for keys in ({}, {"stop": None})]
    assert digests[0] == digests[1] != stage_digests(settings(stop="auto"))["volume"]


def test_an_object_beyond_the_grid_is_named_with_its_cure(scan, caplog):
    slab = {"grid": {"voxels": [2, 24, 24], "voxel_mm": 5.0}}
    reconstruct(scan(**slab))
    assert "beyond the grid" in caplog.text
    assert "reconstruction.surroundings" in caplog.text
    caplog.clear()
    reconstruct(scan(**slab, surroundings={"margin_mm": 60, "voxel_mm": 10, "iterations": 1}))
    reconstruct(scan())
    assert "beyond the grid" not in caplog.text


def moved(geometry, millimetres):
    """The geometry with each view's panel off by some of these."""
    off = np.random.default_rng(1).normal(0, millimetres, (len(geometry), 2))
    panel = geometry.detector + off[:, :1] * geometry.u + off[:, 1:] * geometry.v
    return ScanGeometry(geometry.source, panel, geometry.u, geometry.v, geometry.panel)


def test_a_volume_that_does_not_explain_its_projections_is_named(scan, caplog):
    """Right poses leave what edges of voxels leave; wrong ones are the first cause named."""
    right = scan(iterations=8)
    fitted = reconstruct(right)
    assert fitted.extras["unexplained"]["share"] < 2 * fitted.extras["unexplained"]["edges"]
    assert "warnings" not in fitted.extras and "explain" not in caplog.text
    wrong = reconstruct(right, geometry=moved(views_of(right.scenario), 12.0))
    assert wrong.extras["unexplained"]["share"] > 4 * fitted.extras["unexplained"]["share"]
    (warning,) = wrong.extras["warnings"]
    assert warning in caplog.text
    causes = warning.partition("cures: ")[2].split("; ")
    assert "twinct calibrate" in causes[0] and "thin as a voxel" in causes[-1]
    shares = wrong.extras["diagnosis"]
    assert max(shares, key=lambda name: shares[name]) == "poses"


@pytest.mark.parametrize(
    ("share", "noise", "edges", "much"),
    [(0.3, 0.5, 0.1, True), (0.3, 0.7, 0.1, False), (0.3, 0.0, 0.2, False), (0.05, 0, 0, False)],
)
def test_much_is_more_than_noise_and_edges_leave(share, noise, edges, much):
    assert leaves_much(Unexplained(share, noise, edges)) == much


def test_noise_that_is_known_is_not_taken_for_a_wrong_model(scan):
    clean = scan(iterations=8)
    photons = 100.0
    rng = np.random.default_rng(2)
    noisy = np.maximum(rng.poisson(photons * clean.transmission), 0.5) / np.float32(photons)
    one = replace(clean, transmission=noisy.astype(np.float32))
    A, p = (
        Projector(views_of(clean.scenario), clean.scenario.reconstruction.volume_grid),
        -np.log(one.transmission),
    )
    volume = reconstruct(clean).array
    rest = unexplained(A, p, volume, one.transmission, photons=np.full(12, photons))
    blind = unexplained(A, p, volume, one.transmission, photons=np.full(12, np.inf))
    assert blind.share > 2 * rest.share
    assert rest.noise == pytest.approx(blind.share, rel=0.1)
    full = np.ones(p.shape, np.float32)
    assert unexplained(A, p + 1, volume, full) is None  # no air shows the noise
