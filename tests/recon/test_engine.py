"""The engines against each other, which one is taken, and compiled kernels on disk."""

import logging
import os
import pickle
import platform
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from solvers import with_total_variation

from twinct.core import card
from twinct.core.card import DEVICE_VARIABLE
from twinct.core.errors import InputError, MemoryShortageError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, engine, fast, fdk, os_sart, sart
from twinct.recon.blocks import Blocks
from twinct.recon.engine import Ratio

DEVICE = os.environ.get(DEVICE_VARIABLE) or "cpu"
"""Device of the card's kernels: the processor, unless the environment names a card."""

ENGINES = "vector", "plain"

SINGLE = 2e-5
"""Float32 places and sums against float64, of the largest value. Measured 2e-7 to 4e-6."""
STORED = 1 / 32767
"""Step of a dual vector that is stored in 16 bits: rounding of sums may turn one into the next."""

SHOWN = 1e-4
"""For sums of volumes during a reconstruction. Measured 1e-6 to 1e-5."""


@pytest.fixture
def pair(random_geometry, turned_grid, panel):
    """The same projector with either engine: some rays miss, some views are truncated."""
    geometry = random_geometry(6, panel, np.random.default_rng(0))
    return [Projector(geometry, turned_grid, engine=name) for name in ENGINES]


@pytest.fixture(params=["vector", "cuda"])
def against_plain(request, random_geometry, turned_grid, panel, monkeypatch):
    """A projector with a fast engine, and with the plain one; the card's kernels run here."""
    monkeypatch.setenv(DEVICE_VARIABLE, DEVICE)
    geometry = random_geometry(6, panel, np.random.default_rng(0))
    return [Projector(geometry, turned_grid, engine=name) for name in (request.param, "plain")]


def _note_volume(seen, step):
    seen.append(float(np.abs(step.volume).sum()))


SOLVERS = {
    "sart": partial(sart, iterations=2, relaxation=0.5),
    "sart, best pass": partial(sart, iterations=4, relaxation=1.0, stop="auto"),
    "os_sart": partial(os_sart, iterations=2, relaxation=0.5, subsets=4),
    "fast": fast,
    "fdk": fdk,
    "exact adjoint": partial(with_total_variation, iterations=2, regularisation=0.01),
}


def close(fast, plain):
    assert np.abs(fast - plain).max() < SINGLE * np.abs(plain).max()


def test_engines_agree_on_the_operator(against_plain):
    fast, plain = against_plain
    rng = np.random.default_rng(1)
    x = rng.standard_normal(fast.domain_shape).astype(np.float32)
    y = rng.standard_normal(fast.range_shape).astype(np.float32)
    close(fast(x), plain(x))
    close(fast.T(y), plain.T(y))
    close(fast.chords(), plain.chords())


@pytest.mark.parametrize("masked", [False, True])
def test_engines_agree_on_an_update(against_plain, masked):
    rng = np.random.default_rng(2)
    start = rng.random(against_plain[0].domain_shape, dtype=np.float32)
    measured = rng.random(against_plain[0].range_shape, dtype=np.float32) * 30
    mask = rng.random(against_plain[0].range_shape[1:]) < 0.8 if masked else None
    results = []
    for A in against_plain:
        x, change, seen = start.copy(), np.zeros_like(start), np.zeros_like(start)
        for view in range(len(A)):
            estimate, counts = A.update(x, view, measured[view], relaxation=0.5, mask=mask, floor=0)
            A.update(start, view, measured[view], relaxation=1, mask=mask, change=change, seen=seen)
        results.append((x, change, seen, estimate, counts))
    for one, plain in zip(*results, strict=True):
        close(one, plain)
    assert (results[0][0] == 0).any(), "the floor was reached"


PITCHES = {"small pixels": 0.4, "usual pixels": 1.7, "large pixels": 5.0}
"""Pixels as large as 0.2, 0.9 and 2.6 voxels: with AVX-512, windows hold the voxels around the rays
except for the last, and the pixels around voxels except for the first."""


@pytest.fixture(params=PITCHES.values(), ids=PITCHES)
def job(request, random_geometry):
    """Views with pixels of a size, a grid, a volume, projections, intact pixels and blocks."""
    pitch, rng = request.param, np.random.default_rng(4)
    panel = Panel(round(90 / pitch), round(110 / pitch), pitch, pitch)
    geometry, grid = random_geometry(8, panel, rng), VolumeGrid((70, 43, 38), 1.0)
    start = rng.random(grid.shape, dtype=np.float32)
    measured = rng.random((8, *panel.shape), dtype=np.float32) * 50
    intact = rng.random(panel.shape) >= 0.002
    blocks = Blocks(np.uint8(rng.random([-(-n // 8) for n in start.shape]) < 0.6))
    return geometry, grid, start, measured, intact, blocks


def done(engine_name, geometry, grid, start, measured, intact, blocks):
    """Line integrals, and volumes after an update from each view."""
    A = Projector(geometry, grid, engine_name)
    found = [A(start)]
    for part, mask in ((A, None), (A, intact), (A.within(blocks), intact)):
        x = start.copy()
        part.blocks.clear(x)
        for view in range(len(A)):
            part.update(x, view, measured[view], relaxation=0.5, floor=0.1, mask=mask)
        assert np.abs(x - start).max() > 0.5
        found.append(x)
    return found


def test_engines_agree_for_pixels_of_any_size(job):
    for one, plain in zip(done("vector", *job), done("plain", *job), strict=True):
        close(one, plain)


def test_blocks_that_hold_something_have_all_line_integrals(against_plain):
    x = np.zeros(against_plain[0].domain_shape, np.float32)
    x[-1, -1, -1], x[5, 9, 2], x[8, 7, 16] = 1, 2, 3
    holding = Blocks.holding(x)
    assert holding.filled.sum() == 3
    for A in against_plain:
        close(A.within(holding)(x), A(x))


OLDER = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+fma"}
"""A processor without AVX-512, for which the vector engine is compiled."""

CHILD = f"""
import importlib.util, pickle, sys
from pathlib import Path
spec = importlib.util.spec_from_file_location("test_engine", {__file__!r})
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
from twinct.recon._vector.windows import AVAILABLE
assert not AVAILABLE
job = pickle.loads(Path(sys.argv[1]).read_bytes())
Path(sys.argv[2]).write_bytes(pickle.dumps(module.done("vector", *job)))
"""


@pytest.fixture(scope="module")
def older(tmp_path_factory):
    """Surroundings of processes that compile for an older processor, once for this module."""
    folder = tmp_path_factory.mktemp("older")
    support = str(Path(__file__).parents[1] / "support")
    return os.environ | OLDER | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": support}


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.tutorial
@pytest.mark.skipif(platform.machine() != "x86_64", reason="needs an x86-64 processor")
def test_engines_agree_without_avx512(job, older, tmp_path):
    given, found = tmp_path / "job", tmp_path / "found"
    given.write_bytes(pickle.dumps(job))
    result = subprocess.run(
        [sys.executable, "-c", CHILD, str(given), str(found)],
        env=older,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    volumes = pickle.loads(found.read_bytes())
    for one, plain in zip(volumes, done("plain", *job), strict=True):
        close(one, plain)


def test_engines_agree_within_blocks(against_plain):
    rng = np.random.default_rng(2)
    start = rng.random(against_plain[0].domain_shape, dtype=np.float32)
    blocks = Blocks(np.uint8(rng.random([-(-n // 8) for n in start.shape]) < 0.3))
    blocks.clear(start)
    measured = rng.random(against_plain[0].range_shape, dtype=np.float32) * 30
    results = []
    for A in against_plain:
        whole, part, x = A(start), A.within(blocks), start.copy()
        close(part(start), whole)
        for view in range(len(A)):
            part.update(x, view, measured[view], relaxation=0.5, floor=0)
        results.append(x)
        blocks.clear(x)
        np.testing.assert_array_equal(x, results[-1])
    close(*results)
    assert 0 < blocks.share < 1
    assert np.abs(results[0] - start).max() > 0.1


def test_engines_agree_on_back_projection_and_total_variation(against_plain):
    rng = np.random.default_rng(3)
    images = rng.standard_normal(against_plain[0].range_shape).astype(np.float32)
    shape = against_plain[0].domain_shape
    z, known = (rng.standard_normal(shape).astype(np.float32) for _ in range(2))
    before = rng.standard_normal(shape).astype(np.float32)
    q = rng.random([-(-n // 2) for n in shape], dtype=np.float32) + 1
    dual = rng.integers(-9000, 9000, (6, *shape)).astype(np.int16)
    seams = (rng.random(shape) < 0.1).astype(np.uint8)
    filled = np.ones([-(-n // 8) for n in shape], np.uint8)
    filled[0, 0, 0] = 0
    inverse, radii = 1 / against_plain[0].grid.voxel, np.array([0.1, 0.05])
    results = []
    for A in against_plain:
        spread, b, p, x = np.zeros_like(z), z.copy(), dual.copy(), before.copy()
        A.back_project(images, np.linspace(1e4, 2e4, len(A)), spread)
        A.kernels.weigh(b, q)
        weighted, blocks = b.copy(), Blocks(filled)
        A.kernels.ascend(b, q, p, radii, known, seams, inverse, np.float32(-0.5), 1.8, blocks)
        A.kernels.settle(b, q, p, radii, inverse, np.float32(-0.5), np.float32(0.3), x, blocks)
        results.append((spread, weighted, b, x, p.astype(np.int32)))
    for one, plain in zip(*(result[:-1] for result in results), strict=True):
        close(one, plain)
    # Rounding of sums may turn a stored step into the next.
    assert np.abs(results[0][-1] - results[1][-1]).max() <= 1
    assert np.abs(results[0][-1] - dual).max() > 9000
    wide = q.repeat(2, 0).repeat(2, 1).repeat(2, 2)[tuple(map(slice, shape))]
    np.testing.assert_allclose(results[0][1], z * wide, rtol=1e-6)


def test_a_ratio_has_its_border_and_counts_what_is_missing(pair):
    measured = np.arange(6, dtype=np.float32).reshape(2, 3)
    length = np.array([[2, 2, 0.5], [4, 4, 4]], np.float32)
    for A in pair:
        ratio = Ratio.room(A.kernels, 2, 3)
        nothing = np.zeros_like(measured)
        A.kernels.ratio(measured, nothing, length, np.float32(1), np.float32(1), *ratio)
        np.testing.assert_array_equal(
            ratio.image, [[0, 0, 0.5, 0, 0], [0, 0, 0.5, 0, 0], *[[0.75, 0.75, 1, 1.25, 1.25]] * 2]
        )
        np.testing.assert_array_equal(ratio.counts, [[1, 1, 1, 0, 0]] * 2 + [[1] * 5] * 2)
        for (r, c), missing in np.ndenumerate(ratio.missing):
            assert missing == (ratio.counts[:r, :c] == 0).sum()


@pytest.mark.parametrize("name", SOLVERS)
def test_a_card_gives_the_volumes_of_the_processor(name, circle, monkeypatch):
    monkeypatch.setenv(DEVICE_VARIABLE, DEVICE)
    k, j, i = np.indices((18, 20, 22)) - 9.5
    body = np.float32((k * k + (j - 2) ** 2 + 2 * i * i < 50) * 0.04)
    volumes, passes = [], []
    for engine_name in ("vector", "cuda"):
        grid, views = VolumeGrid((18, 20, 22), 1.1), circle(24, Panel(26, 30, 2.0, 2.0))
        A, seen = Projector(views, grid, engine_name), []
        volumes.append(SOLVERS[name](A, A(body), callback=partial(_note_volume, seen)).array)
        passes.append(seen)
    assert np.abs(volumes[0]).max() > 0.02
    # Coarse levels of ``fast`` can turn rounding into 1e-4 at single voxels, with any engine.
    limit = SINGLE if name != "fast" else STORED
    assert np.sqrt(np.mean((volumes[1] - volumes[0]) ** 2)) < limit * np.abs(volumes[0]).max()
    if name != "fast":
        np.testing.assert_allclose(passes[1], passes[0], rtol=SHOWN)


def test_either_engine_can_be_asked_for(pair, monkeypatch):
    geometry, grid = pair[0].geometry, pair[0].grid
    assert pair[0].kernels is not pair[1].kernels
    assert pair[1][0].kernels is pair[1].on(grid).kernels is pair[1].kernels
    assert Projector(geometry, grid).kernels is pair[0].kernels
    monkeypatch.setenv(engine.ENGINE_VARIABLE, "plain")
    assert Projector(geometry, grid).kernels is pair[1].kernels
    assert Projector(geometry, grid, engine="vector").kernels is pair[0].kernels
    with pytest.raises(InputError, match="engine is 'fast'; it must be vector, plain or cuda"):
        Projector(geometry, grid, engine="fast")
    monkeypatch.setenv(engine.ENGINE_VARIABLE, "slow")
    with pytest.raises(
        InputError, match="TWINCT_ENGINE is 'slow'; it must be vector, plain or cuda"
    ):
        Projector(geometry, grid)


def test_plain_is_taken_where_vector_does_not_compile(monkeypatch, caplog):
    plain = engine.kernels("plain")

    def broken(name):
        if name == "vector":
            raise RuntimeError("no such instruction")
        return plain

    monkeypatch.setattr(engine, "_imported", broken)
    engine._best.cache_clear()
    try:
        with caplog.at_level(logging.WARNING):
            assert engine.kernels() is engine.kernels() is plain
    finally:
        engine._best.cache_clear()
    assert [record.getMessage() for record in caplog.records] == [
        "the vector engine does not compile here, so the plain engine is used: no such instruction"
    ]
    with pytest.raises(InputError, match=r"engine vector does not compile here \(no such instr"):
        engine.kernels("vector")


@pytest.mark.process
def test_settings_of_algorithms_need_no_compiler():
    code = (
        "import sys, twinct.scenario, twinct.recon.algorithms\n"
        "assert not {'numba', 'llvmlite'} & sys.modules.keys()"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


DIGESTS = """
import hashlib
import numpy as np
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, fdk, fast, os_sart, sart, sirt, cgls
from twinct.trajectory import CircleTrajectory
from twinct.trajectory import commanded_views
circle = CircleTrajectory(kind="circle", views=12, sod_mm=200, sdd_mm=400)
A = Projector(commanded_views(circle, Panel(29, 31, 3.0, 3.0)), VolumeGrid((20, 22, 21), 2.0))
rng = np.random.default_rng(0)
p = A(rng.random(A.domain_shape, dtype=np.float32))
p += rng.normal(0, 0.3, p.shape).astype(np.float32)
for volume in (
    sart(A, p, iterations=2, relaxation=0.5),
    os_sart(A, p, iterations=2, relaxation=0.5, subsets=4),
    sirt(A, p, iterations=2),
    cgls(A, p, iterations=3),
    fast(A, p, strength=0.01, passes=2),
    fdk(A, p),
):
    print(hashlib.sha256(volume.array.tobytes()).hexdigest())
"""


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.slow
@pytest.mark.parametrize("name", ["vector", "plain"])
def test_the_process_that_compiles_gives_the_bits_of_later_ones(name, tmp_path):
    surroundings = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "TWINCT_ENGINE": name}
    runs = []
    for _ in range(2):
        result = subprocess.run(
            [sys.executable, "-c", DIGESTS], env=surroundings, capture_output=True, text=True
        )
        assert result.returncode == 0, result.stderr
        runs.append(result.stdout.split())
    assert len(set(runs[0])) == 6
    assert runs[0] == runs[1]


def test_kernels_on_disk_go_by_all_their_sources(tmp_path, monkeypatch):
    from twinct.recon._vector import cache

    package = tmp_path / "recon" / "_vector"
    package.mkdir(parents=True)
    (tmp_path / "rays").mkdir()
    others = (tmp_path / f"{name}.py" for name in cache.OTHERS)
    engine = (package / "march.py", *others)
    for source in (*engine, package / "rays.py"):
        source.write_text("old")
    monkeypatch.setattr(cache, "_HERE", package)
    before = cache._digest()
    assert cache._digest() == before
    for source in engine:
        source.write_text("new")
        assert cache._digest() != before
        source.write_text("old")
    assert cache._digest() == before


def test_kernels_are_compiled_once_and_nothing_else_is_touched(tmp_path, monkeypatch):
    from twinct.recon._vector import cache

    stranger = tmp_path / "sart-1.py311.nbi"
    stranger.touch()
    started = []

    def compiler(command, env, **_):
        started.append(command)
        draft = env[cache._COMPILING]
        open(os.path.join(draft, "forward.nbc"), "w").close()
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(cache.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(cache.subprocess, "run", compiler)
    folder = cache._folder()
    assert cache._folder() == folder
    assert len(started) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [folder.name, stranger.name]
    assert [path.name for path in folder.iterdir()] == ["forward.nbc"]


def test_what_does_not_compile_leaves_its_reason_and_no_folder(tmp_path, monkeypatch):
    from twinct.recon._vector import cache

    def compiler(command, **_):
        return subprocess.CompletedProcess(command, 1, "", "Traceback\nLLVMError: no vectors\n")

    monkeypatch.setattr(cache.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(cache.subprocess, "run", compiler)
    with pytest.raises(RuntimeError, match="^LLVMError: no vectors$"):
        cache._folder()
    assert not list(tmp_path.iterdir())


def test_a_machine_without_a_card_is_told_what_to_do(pair, monkeypatch):
    monkeypatch.delenv(DEVICE_VARIABLE, raising=False)
    monkeypatch.setattr(card.warp(), "get_devices", lambda: ["cpu"])
    with pytest.raises(
        InputError, match="no CUDA card or driver .*unset TWINCT_ENGINE.*gvxr or mesh"
    ):
        Projector(pair[0].geometry, pair[0].grid, engine="cuda")
    monkeypatch.setenv(DEVICE_VARIABLE, "gpu")
    with pytest.raises(InputError, match="TWINCT_CUDA_DEVICE is 'gpu'; it must be cuda:N or cpu"):
        Projector(pair[0].geometry, pair[0].grid, engine="cuda")


def test_a_card_that_is_too_small_refuses_a_volume_before_any_work(pair, monkeypatch):
    class Small:
        is_cuda, free_memory, name = True, 1000, "a small card"

    monkeypatch.setenv(DEVICE_VARIABLE, "cpu")
    A = Projector(pair[0].geometry, pair[0].grid, engine="cuda")
    monkeypatch.setattr(A.kernels, "_device", Small())
    with pytest.raises(MemoryShortageError, match="of the card a small card are needed"):
        sart(A, np.zeros(A.range_shape), iterations=1, relaxation=0.5)
