"""The stated peaks against what is allocated, and the refusal of what does not fit."""

import subprocess
import sys
import tracemalloc
from functools import partial

import numba
import numpy as np
import pytest

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, cgls, fast, fdk, os_sart, prior_tv, sart, sirt
from twinct.recon.algorithms import BUILT_IN
from twinct.recon.volume import Volume


def with_prior(A, p):
    """With a prior of as many voxels, which counts, too."""
    prior = np.zeros(A.domain_shape, np.float32)
    prior[:, : len(prior) // 2] = 2 / A.grid.size_mm[1]
    p[:] = A(prior)  # it lies where it shall
    settings = {"iterations": 2, "regularisation": 0.01, "subsets": 1, "tv_steps": 1, "rounds": 2}
    return prior_tv(A, p, Volume(prior, A.grid), **settings)


RUNS = {
    "sart": partial(sart, iterations=2, relaxation=0.5),
    "fast": fast,
    "os_sart": partial(os_sart, iterations=2, relaxation=0.8, subsets=2),
    "sirt": partial(sirt, iterations=2),
    "cgls": partial(cgls, iterations=2),
    "prior_tv": with_prior,
    "fdk": fdk,
}
SLACK = 0.3
"""Images, planes and interpreter objects, in volumes or projections of this size."""
SCRATCH = 1_950_000
"""Bytes that each thread of a projector works in, of any volume; 1,862,000 were measured."""


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize(
    "large", ["volume", pytest.param("projections", marks=pytest.mark.tutorial)]
)
def test_peak_is_as_stated(name, large, circle):
    grid, views, panel = (
        (VolumeGrid((128, 128, 128), 0.3), 24, Panel(16, 16, 5.0, 5.0))
        if large == "volume"
        else (VolumeGrid((16, 16, 16), 2.5), 240, Panel(64, 64, 1.0, 1.0))
    )
    A = Projector(circle(views, panel), grid)
    p = np.ones(A.range_shape, np.float32)
    small = Projector(A.geometry[:: len(A) // 8], VolumeGrid((4, 4, 4), 2.0))
    RUNS[name](small, p[:: len(A) // 8])  # compiles
    tracemalloc.start()
    try:
        RUNS[name](A, p)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    needs = BUILT_IN[name]
    share = 4 * (needs.volumes * np.prod(grid.shape) + needs.projections * p.size)
    unit = 4 * np.prod(grid.shape) if large == "volume" else p.nbytes
    assert peak < share + SLACK * unit + SCRATCH * numba.get_num_threads()
    assert peak > share - 0.6 * unit, "stated more than is taken"


@pytest.mark.process
def test_job_that_cannot_fit_is_refused_with_the_figures():
    code = """
import resource, numpy as np
from twinct.core.errors import MemoryShortageError
from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector, sirt
from twinct.trajectory import CircleTrajectory, commanded_views
geometry = commanded_views(CircleTrajectory(kind="circle", views=4), Panel(8, 8, 20.0, 20.0))
A = Projector(geometry, VolumeGrid((512, 512, 512), 0.31))
used = next(int(l.split()[1]) for l in open("/proc/self/status") if l.startswith("VmSize")) * 1024
resource.setrlimit(resource.RLIMIT_AS, (used + 2**30, resource.RLIM_INFINITY))
try:
    sirt(A, np.zeros(A.range_shape), iterations=1)
except MemoryShortageError as error:
    print(error.exit_code, error)
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("2 sirt with a grid of (512, 512, 512) voxels")
    assert "3 x 0.50 GiB of voxels" in result.stdout
    assert "needs 1.59 GiB of memory" in result.stdout
    assert "are available (limit of this process (ulimit)): use fewer or larger" in result.stdout
    assert "or sart" in result.stdout
