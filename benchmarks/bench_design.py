"""Measure how soon the page of ``twinct design`` answers: image, scatter, sphere, verdicts.

A browser without a screen moves the controls, as a user does, and waits for the page's message.

    python benchmarks/bench_design.py [SCENARIO ...] [--moves 50]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from twinct.design.desk import State
from twinct.design.draft import Draft
from twinct.design.page import DesignPage
from twinct.viewer.server import LOOPBACK, address, close, serve

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from listener import Listener  # noqa: E402

DEFAULT = ("demo", "patient_head", "operating_room")
PANEL = "\ndetector: {columns: 160, rows: 120, pixel_pitch_mm: 2.0, scatter: {kind: monte_carlo}}\n"
TURN_S = 0.002


def wait(done: Callable[[], object]) -> None:
    """Poll closely: the seconds are what is measured."""
    while not done():
        time.sleep(TURN_S)


def measure(name: str, moves: int, folder: Path) -> dict[str, list[float]]:
    file = folder / f"{name}.yaml"
    file.write_text(f"extends: {name}{PANEL if name != 'demo' else ''}\n", encoding="utf-8")
    server = serve(LOOPBACK, 0)
    page = DesignPage(server, Draft.open(file), folder / name, rest_s=3600.0)
    with closing(page), closing(Listener(address(server))) as listener:
        begun = time.perf_counter()
        page.settle()
        found: dict[str, list[float]] = {"all first answers": [time.perf_counter() - begun]}
        scenario = page.bench.draft.scenario
        assert scenario is not None
        views = int(getattr(scenario.trajectory, "views", 100))

        def fresh(subject: str) -> bool:
            answer = page.bench.answer(subject)
            if answer.state is State.FAILED:
                raise SystemExit(f"{subject}: {'; '.join(answer.problems)}")
            asked = answer.question
            # A finer shading may be asked for already: the question says which text was answered.
            return (
                asked is not None
                and asked.source.text == page.bench.draft.text
                and page.bench.draft.text != before
            )

        def timed(what: str, act: Callable[[], None], done: Callable[[], object]) -> None:
            start = time.perf_counter()
            act()
            wait(done)
            found.setdefault(what, []).append(time.perf_counter() - start)

        for k in range(moves):
            view = (7 * k + 3) % views
            timed(
                "view slider to preview image on the page",
                lambda view=view: listener.set("view", view),
                lambda view=view: f"view {view}, 160 x 120 pixels" in listener.texts(),
            )
        page.settle()
        for k in range(max(moves // 5, 3) if scenario.detector.scatter else 0):
            view = (11 * k + 5) % views
            timed(
                "view slider to scatter in the preview",
                lambda view=view: listener.set("view", view),
                lambda view=view: f"view {view}, 160 x 120 pixels (preview, w" in listener.texts(),
            )
        arm = "source arm"
        listener.set("body", arm)
        wait(page.move.chosen)
        chosen = page.move.chosen()
        assert chosen is not None
        base = list(chosen.position_mm)
        for k in range(max(moves // 5, 3)):
            before, told = page.bench.draft.text, len(shadings(listener))
            to = (base[0] + 5 * (k % 5 + 1), base[1] + 3 * (k + 1), base[2])
            timed(
                "base moved to new coarse shading on the page",
                lambda to=to: listener.set("position, mm", to),
                lambda told=told: fresh("sphere") and len(shadings(listener)) > told,
            )
            page.settle()
        key, values = slider(page)
        for k in range(max(moves // 5, 3)):
            before = page.bench.draft.text
            value = values[k % len(values)]
            start = time.perf_counter()
            listener.set(key, value)
            wait(lambda: fresh("views"))
            first = time.perf_counter() - start
            wait(lambda: fresh("motion"))
            found.setdefault("path parameter to reach of all views", []).append(first)
            found.setdefault("path parameter to plan, time and clearance", []).append(
                time.perf_counter() - start
            )
            page.settle()
    close(server)
    return found


def slider(page: DesignPage) -> tuple[str, list[float]]:
    """The slider of the path that is moved, and its values."""
    known = page.path.sliders
    for key in ("latitude_amplitude_deg", "latitude_deg", "longitude_range_deg"):
        if key in known:
            now = known[key].value
            return known[key].label, [now - 2 - k for k in range(7)]
    raise SystemExit(f"no slider to move among {', '.join(known)}")


def shadings(listener: Listener) -> list[Any]:
    return [one for one in listener.heard if one.get("name") == "/design/sphere"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", default=DEFAULT)
    parser.add_argument("--moves", type=int, default=50)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in given.scenarios:
            print(f"{name}:")
            for what, seconds in measure(name, given.moves, Path(folder)).items():
                middle, worst = statistics.median(seconds), max(seconds)
                print(f"  {what}: median {middle:.2f} s, worst {worst:.2f} s, {len(seconds)} moves")


if __name__ == "__main__":
    main()
