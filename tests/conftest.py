"""What several test files need."""

from __future__ import annotations

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
from numba.core import event as numba_event
from scipy.spatial.transform import Rotation
from xdist.scheduler import LoadFileScheduling, LoadScopeScheduling

from twinct.core.threads import available_threads, limit_threads
from twinct.geometry import Panel, Pose, ScanGeometry

if TYPE_CHECKING:
    import trimesh
    from xdist.remote import Producer
    from xdist.workermanage import WorkerController

    from twinct.robots.cell import CellModel

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # As in a shell's background job: what a test starts would not hear of Ctrl-C either.
    signal.signal(signal.SIGINT, signal.default_int_handler)

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


TOGETHER = {"cluster": "pools", "workers": "pools", "study": "pools"}
"""Folders that share a worker: of pools of processes, one at a time is enough for a machine."""

FIRST = ("pools", "test_same_bytes.py", "test_extensions.py", "test_browser.py", "test_fuzz.py")
"""Scopes that take longest: they start first, so that no worker works alone at the end."""

LAST = "test_rtk.py"
"""Files that load ITK: they come last in one worker, as gVXR aborted once after them."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadScopeScheduling:
    """Give each file to one worker, and all files that start pools, or Ray, to one of them.

    So two crowds of processes at most run at once with two workers: a pool or Ray, and a scan over
    ROS 2 or a command.
    """

    class Scopes(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            if Path(file).name == LAST:
                return LAST
            return next((TOGETHER[part] for part in Path(file).parts if part in TOGETHER), file)

        def _assign_work_unit(self, node: WorkerController) -> None:
            waiting = {Path(scope).name: scope for scope in self.workqueue}
            if first := next((waiting[name] for name in FIRST if name in waiting), None):
                self.workqueue.move_to_end(first, last=False)
            super()._assign_work_unit(node)

        def schedule(self) -> None:
            super().schedule()
            if (last := self.workqueue.pop(LAST, None)) is not None:
                self.workqueue[LAST] = last

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
