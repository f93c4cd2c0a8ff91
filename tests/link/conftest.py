"""Scans around tiny engines, a foreign node, and a look at what is left of a process."""

from __future__ import annotations

import fcntl
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from waiting import HANG_S, Patience, until

from twinct.geometry.wire import PosePairs
from twinct.link.environment import Domain, middleware_settings
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario

HERE = Path(__file__).parent
LOOK_S = 0.05
"""Discovery wakes nobody who spins, so it is looked at this often."""
AGAIN_S = 2.0
"""Who gets no answer for so long asks again."""
SCENARIO = HERE.parents[1] / "scenarios" / "demo.yaml"
BALL = (
    "specimen.parts=[{name: ball, material: bone, "
    "shape: {kind: sphere, radius_mm: 60, mesh_resolution_mm: 4}}]"
)
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
def targets(scenario: Scenario) -> list[PosePairs]:
    return SimulationBuilder(scenario).targets


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
    """What the tiny engines of all processes did, and what they are told to do."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @contextmanager
    def for_nodes(self) -> Iterator[None]:
        """Give these notes to the nodes that start meanwhile."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("FAKE_NOTES", str(self.folder))
            yield

    def count(self, what: str) -> int:
        """How often they worked: ``move`` or ``render``."""
        file = self.folder / what
        return len(file.read_text().splitlines()) if file.exists() else 0

    def tell(self, what: str, number: float) -> None:
        """``one_pixel`` or ``short_arm``; 0 for as usual."""
        (self.folder / what).write_text(str(number))

    @contextmanager
    def renders_held(self, first: int = 0) -> Iterator[None]:
        """No image from a first view on is finished meanwhile; it counts once it has begun."""
        draft, gate = self.folder / "new_gate", self.folder / "gate"
        with draft.open("w") as held:
            fcntl.flock(held, fcntl.LOCK_EX)  # a render waits for this lock
            held.write(str(first))
            held.flush()
            draft.replace(gate)
            try:
                yield
            finally:
                gate.unlink()


@pytest.fixture
def notes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Notes]:
    """Of the nodes that this test starts."""
    own = Notes(tmp_path_factory.mktemp("notes"))
    with own.for_nodes():
        yield own


@pytest.fixture(scope="module")
def lasting_notes(tmp_path_factory: pytest.TempPathFactory) -> Notes:
    """For nodes that several tests share."""
    return Notes(tmp_path_factory.mktemp("notes"))


@pytest.fixture
def asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """However slow the machine is, no rig asks again: nothing is said twice."""
    monkeypatch.setattr("twinct.link.rig.FIRST_REPEAT_S", HANG_S)


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
        with middleware_settings():  # read once in a process, which may hold twinct's nodes too
            rclpy.init(
                context=self.context,
                domain_id=domain_id,
                signal_handler_options=SignalHandlerOptions.NO,
            )
        self.node = rclpy.create_node("somebody_else", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: dict[str, list[Any]] = {}

    def listen(self, topic: str, kind: Any, *, latched: bool = True) -> list[Any]:
        """What is heard of a topic: all that it keeps too, or, as rclpy's default is, only the new.

        Only with the first nothing is missed until both nodes have discovered each other.
        """
        from rclpy.qos import DurabilityPolicy, QoSProfile

        messages = self.heard.setdefault(topic, [])
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=1000, durability=durability)
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, topic: str, kind: Any) -> Any:
        return self.node.create_publisher(kind, topic, 10)

    def until(self, done: Callable[[], object], event: str = "what the test waits for") -> None:
        """Handle what comes in until a condition holds."""
        patience = Patience()
        while not done():
            patience.check(event)
            self.executor.spin_once(timeout_sec=LOOK_S)

    def ask(self, send: Callable[[], object], done: Callable[[], object]) -> None:
        """Send until there is an answer: nodes that discover each other may miss the first."""
        send()
        again = self.node.create_timer(AGAIN_S, send)
        self.until(done, "an answer")
        self.node.destroy_timer(again)

    def call(self, client: Any, request: Any) -> Any:
        """What a service answers: the same each time, for it may be asked more than once."""
        self.until(client.service_is_ready, "a service")
        sent: list[Any] = []
        self.ask(
            lambda: sent.append(client.call_async(request)),
            lambda: any(future.done() for future in sent),
        )
        return next(future for future in sent if future.done()).result()

    @staticmethod
    def delivered(*publishers: Any) -> None:
        """Wait until all subscriptions that these have matched hold what was published."""
        from rclpy.duration import Duration

        for publisher in publishers:
            assert publisher.wait_for_all_acked(Duration(seconds=HANG_S)), publisher.topic_name

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

        def get_subscription_count(self) -> int:
            return 1

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
def ended() -> Callable[[int], bool]:
    """Whether a process has ended; one that only waits for its parent to look has."""

    def has_ended(pid: int) -> bool:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return True
        return stat.rpartition(")")[2].split()[0] == "Z"

    return has_ended


@pytest.fixture
def wait_for_end(ended: Callable[[int], bool]) -> Callable[[list[int]], None]:
    """Waits until all of some processes have ended."""

    def wait(pids: list[int]) -> None:
        until(lambda: all(map(ended, pids)), f"the end of the processes {pids}")

    return wait
