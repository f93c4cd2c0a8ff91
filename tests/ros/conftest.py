"""Scans around tiny engines, a foreign node, and a look at what is left of a process."""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest

from twinct.ros.environment import Domain
from twinct.scan import Workshop
from twinct.scenario import Scenario, load_scenario
from twinct.views import Target

HERE = Path(__file__).parent
SCENARIO = HERE.parents[1] / "scenarios" / "demo.yaml"
BALL = "specimen.parts=[{name: ball, shape: {kind: sphere, radius_mm: 60}, material: bone}]"
TINY = [
    *("trajectory.views=12", "detector.columns=32", "detector.rows=24"),
    *("detector.pixel_pitch_mm=10", BALL),
]


@pytest.fixture(autouse=True)
def _no_domain_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Twelve small views of a ball."""
    return load_scenario(SCENARIO, TINY)


@pytest.fixture(scope="module")
def short() -> Scenario:
    """Four of them along a short way: quick to plan for real arms."""
    short_way = ["trajectory.longitude_range_deg=20", "trajectory.latitude_amplitude_deg=5"]
    return load_scenario(SCENARIO, [*TINY, "trajectory.views=4", *short_way])


@pytest.fixture(scope="module")
def targets(scenario: Scenario) -> list[Target]:
    return Workshop(scenario).targets


@pytest.fixture(scope="module")
def fake_command() -> tuple[str, ...]:
    """Starts a node of a scan around a tiny engine."""
    return sys.executable, str(HERE / "fake_node.py")


@pytest.fixture
def fakes() -> ModuleType:
    """The tiny engines themselves."""
    spec = importlib.util.spec_from_file_location("fake_node", HERE / "fake_node.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Notes:
    """What the tiny engines of all processes did, and how they are slowed down."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def count(self, what: str) -> int:
        """How often they worked: ``move`` or ``render``."""
        file = self.folder / what
        return len(file.read_text().splitlines()) if file.exists() else 0

    def tell(self, what: str, number: float) -> None:
        """``render_s``, ``one_pixel`` or ``short_arm``; 0 for as usual."""
        (self.folder / what).write_text(str(number))

    def render_takes(self, seconds: float) -> None:
        self.tell("render_s", seconds)


@pytest.fixture(scope="module")
def notes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Notes]:
    folder = tmp_path_factory.mktemp("notes")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FAKE_NOTES", str(folder))
        yield Notes(folder)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain of the test's own, in ``ROS_DOMAIN_ID`` for the nodes it starts."""
    held = Domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(held.id))
    yield held.id
    held.close()


class Foreign:
    """A node that knows rclpy and the standard messages, and nothing of twinct."""

    def __init__(self, domain_id: int) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self.context = rclpy.Context()
        rclpy.init(
            context=self.context,
            domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node("somebody_else", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = {}

    def listen(self, topic: str, kind: Any) -> list[Any]:
        messages = self.heard.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, 10)
        return messages

    def publisher(self, topic: str, kind: Any) -> Any:
        return self.node.create_publisher(kind, topic, 10)

    def until(self, done: Callable[[], object], timeout_s: float = 20.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not done():
            assert time.monotonic() < deadline, f"nothing within {timeout_s} s"
            self.executor.spin_once(timeout_sec=0.1)

    def ask(
        self, out: Any, message: Any, done: Callable[[], object], timeout_s: float = 20.0
    ) -> None:
        """Publish until there is an answer: nodes that discover each other may miss the first."""
        last = 0.0

        def asked_and_done() -> object:
            nonlocal last
            if time.monotonic() > last + 2.0:
                last = time.monotonic()
                out.publish(message)
            return done()

        self.until(asked_and_done, timeout_s)

    def stay(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture(scope="module")
def foreign() -> Iterator[Callable[[int], Foreign]]:
    """Maker of foreign nodes on a domain."""
    made = []

    def make(domain_id: int) -> Foreign:
        made.append(Foreign(domain_id))
        return made[-1]

    yield make
    for node in made:
        node.close()


class Said:
    """A station that keeps what a node says, in the order in which it says it."""

    class Out(NamedTuple):
        publish: Callable[[Any], None]

    def __init__(self) -> None:
        self.said: list[tuple[Any, Any]] = []
        self.hears: dict[Any, Any] = {}
        self.diagnostics = self
        self.refused: list[tuple[Any, str]] = []

    def publisher(self, topic: Any, *, depth: int | None = None) -> Out:
        return self.Out(lambda message: self.said.append((topic, message)))

    def listen(self, topic: Any, callback: Any) -> None:
        self.hears[topic] = callback

    def listen_to_all(self, topic: Any, callback: Any) -> list[Any]:
        self.hears[topic] = callback
        return []

    def serve(self, service: str, kind: Any, callback: Any) -> None:
        self.hears[service] = callback

    def of(self, topic: Any) -> list[Any]:
        return [message for of, message in self.said if of == topic]

    def tell(self, text: str) -> None:
        pass

    def refuse(self, stamp: Any, text: str, values: dict[str, object]) -> None:
        self.refused.append((stamp, text))


@pytest.fixture
def said() -> Said:
    """In place of a node's station, and of its diagnostics."""
    return Said()


@pytest.fixture
def gone() -> Callable[..., bool]:
    """Whether processes end within some seconds; what waits for its parent to look has ended."""

    def ended(pid: int) -> bool:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return True
        return stat.rpartition(")")[2].split()[0] == "Z"

    def wait(pids: list[int], within_s: float) -> bool:
        deadline = time.monotonic() + within_s
        while not all(ended(pid) for pid in pids):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    return wait
