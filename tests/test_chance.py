"""No test is a matter of time, load or chance, but those that carry the marker ``clock``."""

from __future__ import annotations

from pathlib import Path

import pytest
from chance import findings

HERE = Path(__file__).parent
ALLOWED = {HERE / "support" / "waiting.py", Path(__file__)}
"""The one clock of all other tests, and the examples below."""

FILES = sorted(set(HERE.rglob("*.py")) - ALLOWED)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(HERE)))
def test_no_clock_and_no_chance(file: Path) -> None:
    found = findings(file.read_text(encoding="utf-8"))
    assert not found, "\n".join(f"{file}:{line}: {problem}" for line, problem in found)


@pytest.mark.parametrize(
    "source",
    [
        "time.sleep(1)",
        "from time import monotonic",
        "start = time.perf_counter()",
        "t = time.time()",
        "t = datetime.now()",
        "SCRIPT = 'import time; time.sleep(60)'",
        "SCRIPT = f'''\nstart = time.process_time() + {3}\n'''",
        "Popen(['sleep', '60'])",
        "Popen(('sleep', '60'))",
        "process.communicate(timeout=30)",
        "node.until(done, timeout_s=2 * 10.0)",
        "thread.join(5)",
        "event.wait(0.2)",
        "until(done, 8.0)",
        "PATIENCE_S = 90.0",
        "END_S = 20.0",
        "rng = np.random.default_rng()",
        "x = np.random.normal(size=3)",
        "x = numpy.random.rand(3)",
        "x = random.random()",
        "x = random.Random()",
        "mark = secrets.token_hex(8)",
        "name = uuid.uuid4()",
        "key = os.urandom(8)",
        "turn = Rotation.random()",
        "def test_other():\n    time.sleep(1)\n\n@pytest.mark.clock\ndef test_it():\n    pass",
        "pytestmark = [pytest.mark.ros]\ntime.sleep(1)",
    ],
)
def test_what_is_refused(source: str) -> None:
    assert findings(source)


@pytest.mark.parametrize(
    "source",
    [
        "import time",
        "process.communicate(timeout=HANG_S)",
        "process.wait()",
        "event.wait(timeout=0)",
        "', '.join(names)",
        "Popen(['sleep', 'infinity'])",
        "rng = np.random.default_rng(3)",
        "rng = np.random.default_rng([view, 7])",
        "rng: np.random.Generator",
        "x = random.Random(3)",
        "turn = Rotation.random(random_state=rng)",
        "wait = trajectory.time",
        "monkeypatch.setattr(audience, 'LAST_WORDS_S', 0.05)",
        "@pytest.mark.clock\ndef test_it():\n    time.sleep(1)",
        "@pytest.mark.clock\n@pytest.mark.parametrize('w', ['time.sleep(4)'])\ndef test_it(): ...",
        "pytestmark = [pytest.mark.process, pytest.mark.clock]\ntime.sleep(1)",
    ],
)
def test_what_is_allowed(source: str) -> None:
    assert not findings(source)
