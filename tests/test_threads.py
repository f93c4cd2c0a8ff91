"""One setting bounds the threads of every library, in this process and in those it starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from twinct.core.errors import InputError
from twinct.core.threads import available_threads, threads
from twinct.recon.engine import kernels

DEMO = Path(__file__).parents[1] / "scenarios" / "demo.yaml"
ASK = """
import json, sys
from pathlib import Path
from twinct.core.threads import limit_threads
if sys.argv[1] == "early":
    limit_threads()
import numpy, numba, threadpoolctl
if sys.argv[1] == "late":
    limit_threads(int(sys.argv[2]))
numpy.ones((300, 300)) @ numpy.ones((300, 300))
pools = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
from gvxrPython3 import gvxr
gvxr.createOpenGLContext()
names = [task.joinpath("comm").read_text() for task in Path("/proc/self/task").iterdir()]
renderer = sum(name.startswith("llvmpipe") for name in names)
print(json.dumps([numba.get_num_threads(), max(pools, default=1), renderer]))
"""


def asked(when: str, number: int, environment: dict[str, str]) -> list[int]:
    result = subprocess.run(
        [sys.executable, "-c", ASK, when, str(number)],
        env={k: v for k, v in os.environ.items() if "THREADS" not in k} | environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


@pytest.mark.process
@pytest.mark.parametrize("when", ["early", "late"])
def test_numba_blas_and_renderer_keep_the_bound(when: str) -> None:
    environment = {"TWINCT_THREADS": "1"} if when == "early" else {}
    assert asked(when, 1, environment) == [1, 1, 1]


@pytest.mark.process
def test_the_default_is_what_the_machine_gives() -> None:
    found = asked("early", 0, {})
    assert found[0] == available_threads()
    assert found[1] <= available_threads()


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5", "٣"])
def test_a_bound_that_is_none_is_named(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWINCT_THREADS", text)
    with pytest.raises(InputError, match="TWINCT_THREADS="):
        threads()


TOLD = """
import os
from twinct.core.threads import limit_threads
os.environ.pop("TWINCT_THREADS", None)
limit_threads()
told = os.environ["LP_NUM_THREADS"]
os.environ["TWINCT_THREADS"] = "1"
limit_threads()
print(told, os.environ["LP_NUM_THREADS"], os.environ["BLOSC_NTHREADS"])
print(os.environ["OMP_WAIT_POLICY"])
"""


@pytest.mark.process
def test_what_single_libraries_were_told_stays_unless_a_bound_is_asked_for() -> None:
    result = subprocess.run(
        [sys.executable, "-c", TOLD],
        env=os.environ | {"LP_NUM_THREADS": "7", "OMP_WAIT_POLICY": "active"},
        capture_output=True,
        text=True,
    )
    assert result.stdout.split() == ["7", "1", "1", "active"], result.stderr


def test_threads_that_wait_for_a_kernel_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_WAIT_POLICY", "active")
    kernels("plain")
    assert os.environ["OMP_WAIT_POLICY"] == "active"
    monkeypatch.delenv("OMP_WAIT_POLICY")
    kernels("plain")
    assert os.environ["OMP_WAIT_POLICY"] == "passive"


LATE = """
import os
os.environ.pop("TWINCT_THREADS", None)
import numba, numpy, threadpoolctl
from twinct.core.threads import limit_threads
numba.set_num_threads(1)
limit_threads()
blas = [p["num_threads"] for p in threadpoolctl.threadpool_info() if p["user_api"] == "blas"]
print(numba.get_num_threads(), *blas)
"""


@pytest.mark.process
def test_libraries_told_by_their_user_are_left_alone_unless_a_bound_is_asked_for() -> None:
    result = subprocess.run(
        [sys.executable, "-c", LATE],
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert result.stdout.split() == ["1", "1"], result.stderr


MORE = """
from twinct.core.threads import limit_threads, load_numba
load_numba()
limit_threads(1)
import numba
before = numba.get_num_threads()
limit_threads(2)
print(before, numba.get_num_threads())
"""


@pytest.mark.process
def test_a_second_run_may_have_more_threads_than_the_first() -> None:
    kept = {k: v for k, v in os.environ.items() if "THREADS" not in k}
    result = subprocess.run(
        [sys.executable, "-c", MORE],
        env=kept | {"NUMBA_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
    )
    assert result.stdout.split() == ["1", "2"], result.stderr
