"""What several test files need."""

from __future__ import annotations

import gc
import os
import random
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numba
import numpy as np
import pytest
from crashes import CrashReport
from numba.core import event as numba_event
from scipy.spatial.transform import Rotation
from scopes import Scopes

from twinct.core.threads import available_threads, limit_threads
from twinct.geometry import Panel, Pose, ScanGeometry

if TYPE_CHECKING:
    import trimesh
    from xdist.remote import Producer

    from twinct.robots.cell import CellModel

# A background job ignores SIGINT, and one of nohup SIGHUP: so would what a test starts.
for _number, _handler in (
    (signal.SIGINT, signal.default_int_handler),
    (signal.SIGTERM, signal.SIG_DFL),
    (signal.SIGHUP, signal.SIG_DFL),
):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _handler)

SHARE = max(available_threads() // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")), 1)
"""Threads of a test process: where they outnumber the cores, kernels wait for each other."""

if SHARE < available_threads():
    limit_threads(SHARE)

STARTS = {"subprocess.Popen": 0, "os.posix_spawn": 0, "os.system": 0}
"""Audit events of a process that starts, and the argument that names it."""

LOOKUPS = {"ldconfig", "gcc", "cc", "ld", "objdump", "fc-list", "uname", "lscpu"}
"""What libraries ask when they are loaded: no process of a test."""

_started: list[str] = []
_accounted = 0


def _hear(event: str, arguments: tuple[object, ...]) -> None:
    if event in STARTS:
        name = Path(str(arguments[STARTS[event]])).name
        if name not in LOOKUPS:
            _started.append(name)


sys.addaudithook(_hear)


class _Compilations(numba_event.Listener):
    """Kernels of twinct that numba did not find in its cache."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def on_start(self, event: numba_event.Event) -> None:
        function = event.data["dispatcher"].py_func
        if function.__module__.startswith("twinct."):
            self.names.append(f"{function.__module__}.{function.__name__}")

    def on_end(self, event: numba_event.Event) -> None:
        pass


_compilations = _Compilations()
numba_event.register("numba:compile", _compilations)


def pytest_configure(config: pytest.Config) -> None:
    """Report the stacks of a worker that crashes."""
    config.pluginmanager.register(CrashReport())


def pytest_collection_finish() -> None:
    """Spare the garbage collector the objects that stay: they cost a tenth of the time."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Scopes:
    """Give each file to one worker, and all files that start pools, or Ray, to one of them."""
    return Scopes(config, log)


@pytest.fixture(autouse=True)
def _processes_are_marked(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that starts processes, itself or by its fixtures, without the marker."""
    global _accounted
    yield
    new, _accounted = _started[_accounted:], len(_started)
    if new and request.node.get_closest_marker("process") is None:
        pytest.fail(f"starts {', '.join(sorted(set(new)))} without the marker 'process'")


@pytest.fixture(autouse=True)
def _kernels_are_compiled_beforehand() -> Iterator[None]:
    """Fail a test that compiles a kernel: ``tools/compile_kernels.py`` lacks its types."""
    _compilations.names.clear()
    yield
    if _compilations.names:
        pytest.fail(f"compiles {', '.join(_compilations.names)}: see tools/compile_kernels.py")


@pytest.fixture(autouse=True)
def _pyplot_is_left_as_it_was() -> Iterator[None]:
    """Fail a test that leaves a figure in pyplot, where a user's next plot would land in it."""
    yield
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None and pyplot.get_fignums():
        pyplot.close("all")
        pytest.fail("leaves a figure open in pyplot")


@pytest.fixture(autouse=True)
def _libraries_draw_alike() -> None:
    """Seed the generators that libraries share in a process, as trimesh does."""
    random.seed(0)
    np.random.seed(0)


@pytest.fixture(autouse=True)
def _kernels_keep_to_their_share() -> None:
    numba.set_num_threads(SHARE)


@pytest.fixture
def figure(record_property: Callable[[str, object], None]) -> Callable[[str], None]:
    """Says a measured figure that docs/validation.md quotes: on the screen with -s, and in XML."""

    def say(text: str) -> None:
        record_property("figure", text)
        print(text)  # noqa: T201

    return say


@pytest.fixture
def random_pose() -> Callable[[np.random.Generator], Pose]:
    """A maker of poses anywhere within half a metre."""

    def make(rng: np.random.Generator) -> Pose:
        return Pose(rng.uniform(-500, 500, 3), Rotation.random(random_state=rng).as_quat())

    return make


@pytest.fixture
def random_geometry() -> Callable[..., ScanGeometry]:
    """A maker of views all around the origin, with panels tilted and shifted off the beam."""

    def make(
        views: int,
        panel: Panel,
        rng: np.random.Generator,
        sod: float = 300.0,
        odd: float = 300.0,
        tilt: float = 0.35,
    ) -> ScanGeometry:
        rows = []
        for _ in range(views):
            beam = Rotation.random(random_state=rng).as_matrix()
            tilted = beam @ Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)).as_matrix()
            shift = rng.normal(size=3) * 3
            rows.append((sod * beam[:, 2], shift - odd * beam[:, 2], tilted[:, 0], tilted[:, 1]))
        return ScanGeometry(*(np.array(column) for column in zip(*rows, strict=True)), panel)

    return make


@pytest.fixture(scope="session")
def head() -> trimesh.Trimesh:
    """An ellipsoid of a head's size."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale((72.0, 90.0, 110.0))
    return mesh


@pytest.fixture(scope="session")
def cell(head: trimesh.Trimesh) -> CellModel:
    """The paper's room about it."""
    from twinct.robots.cell import build_cell
    from twinct.scenario import Cell, Detector, load_scenario

    section = load_scenario(Path(__file__).parents[1] / "scenarios" / "paper.yaml").cell
    assert isinstance(section, Cell)
    return build_cell(section, head, Pose.identity(), Detector().panel)
