"""The live page's figures: how soon it is drawn, how fast it follows, what it costs a scan.

    python benchmarks/bench_view.py --drawn DIR    command to a drawn page, Chromium running already
    python benchmarks/bench_view.py --slider       all 399 views and slices of a paper-size folder
    python benchmarks/bench_view.py --live         view stored to view sent, and how it slows a scan
    python benchmarks/bench_view.py --export DIR   size of the page of one file

DIR is a finished run, such as of scenarios/demo.yaml. --drawn needs Debian's chromium and
chromium-driver. The paper-size folder is written for the measurement, with the paper's plan, images
of noise, and volumes of 512^3.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from twinct.core.files.writing import write_text
from twinct.geometry.wire import Reached
from twinct.observers import Event, JointSample, Observer, ViewStored, audience_of
from twinct.recon.volume import Volume
from twinct.runs import Folder, acquire_to_store
from twinct.runs.acquisition import rig_factory
from twinct.runs.folder import as_yaml
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scenario import load_scenario
from twinct.viewer.following import LivePage
from twinct.viewer.live_page import Page
from twinct.viewer.server import LOOPBACK, address, close, serve

HERE = Path(__file__).parent
SCENARIOS = HERE.parent / "scenarios"
sys.path.insert(0, str(HERE.parent / "tests" / "support"))

PORT = 18_080
BLOCK = 10
"""Views in a row that a page hears of, or does not."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drawn", type=Path, metavar="DIR")
    parser.add_argument("--slider", action="store_true")
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--export", type=Path, metavar="DIR")
    asked = parser.parse_args()
    if asked.drawn:
        say(drawn(asked.drawn))
    if asked.slider:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "paper"
            write_paper_size(out)
            say(slider(out))
    if asked.live:
        with tempfile.TemporaryDirectory() as folder:
            say(live(Path(folder) / "out"))
    if asked.export:
        with tempfile.TemporaryDirectory() as folder:
            say(exported(asked.export, Path(folder) / "page.html"))


def say(found: dict) -> None:
    print(json.dumps(found))


def viewing(folder: Path) -> tuple[subprocess.Popen, str]:
    """The command, and the page's address, when it has said that."""
    words = ["view", str(folder), "--port", str(PORT)]
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "twinct", *words], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    first, page = process.stdout.readline().split()[:2]
    assert first == "page:"
    return process, page


def drawn(folder: Path) -> dict:
    """Seconds from the command until the room is in the picture, of three."""
    from browser import Browser

    seconds = []
    with closing(Browser()) as browser:
        for _ in range(3):
            browser.leave()
            start = time.monotonic()
            process, page = viewing(folder)
            try:
                browser.open(page)
                seconds.append(time.monotonic() - start)
                browser.leave()
            finally:
                process.terminate()
                process.wait()
    return {"command to a drawn page, s": [round(s, 2) for s in seconds]}


def write_paper_size(out: Path) -> None:
    """A finished run's folder of the paper's size, but for its report."""
    scenario = load_scenario(SCENARIOS / "paper.yaml")
    builder, folder = SimulationBuilder(scenario), Folder(out)
    out.mkdir()
    write_text(folder.scenario, as_yaml(scenario))
    plan, poses = builder.plan, builder.commanded_poses
    assert plan is not None
    place = (scenario.specimen.world_from_specimen,)
    names = plan.joint_names
    store = ScanStore.create(folder.scan, scenario, poses, names, 1, plan)
    rng = np.random.default_rng(0)
    still = np.zeros(len(names))
    for index, target in enumerate(poses.targets()):
        image = rng.uniform(0.2, 1.0, scenario.detector.panel.shape).astype(np.float32)
        instant = replace(target, object=place)
        state = np.zeros(1)
        reached = Reached(
            instant, names, plan.joints[index], still, still, state, float(index), 20.0
        )
        store.write(index, image, reached)
    grid = scenario.reconstruction.volume_grid
    for file in (folder.volume, folder.truth):
        slabs = rng.uniform(0, 0.05, grid.shape[1:]).astype(np.float32)
        array = np.empty(grid.shape, np.float32)
        array[:] = slabs
        Volume(array, grid).write(file, "benchmark")


def slider(folder: Path) -> dict:
    """Views a second that arrive as the slider goes over all, then slices; and memory."""
    from listener import Listener

    process, where = viewing(folder)
    try:
        page = connected(Listener, where)
        page.wait(lambda: page.node("/projection"))
        page.wait(lambda: [n for n in page.nodes if "/room/" in n])
        time.sleep(10)  # what is filled up in the background
        views = int(page.control("view")["max"]) + 1
        start = time.monotonic()
        for view in [*range(1, views), 0]:
            page.set("view", view)
            page.wait(lambda view=view: f"view {view} of" in page.node("/label")["text"])
        seconds = time.monotonic() - start
        begin = time.monotonic()
        planes = 0
        for axis in "zyx":
            for index in range(0, 512, 32):
                before = page.node(f"/slices/{axis}")["position"]
                page.set(axis, index)
                page.wait(lambda axis=axis, before=before: moved(page, axis, before))
                planes += 1
        of_slices = time.monotonic() - begin
        status = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        memory = dict(line.split(":\t") for line in status if line.startswith(("VmHWM", "RssAnon")))
        page.close()
    finally:
        process.terminate()
        process.wait()
    return {
        "views": views,
        "views a second": round(views / seconds, 1),
        "slices a second": round(planes / of_slices, 1),
        **{name: f"{int(value.split()[0]) / 1e6:.2f} GB" for name, value in memory.items()},
    }


def moved(page, axis: str, before: np.ndarray) -> bool:
    return not np.array_equal(page.node(f"/slices/{axis}")["position"], before)


def connected(listener, page: str):
    """A listener of the page as soon as there is one."""
    end = time.monotonic() + 60
    while True:
        try:
            return listener(page)
        except OSError:
            assert time.monotonic() < end
            time.sleep(0.1)


def live(out: Path) -> dict:
    """Seconds from a stored view to one that is sent, and what the page costs the scan.

    The page hears of ten views, then of ten not, and so on: both kinds are of the same minutes.
    """
    from listener import Listener

    scenario = load_scenario(SCENARIOS / "paper.yaml")
    stored: dict[int, float] = {}
    messages: list[tuple[float, dict]] = []
    server = serve(LOOPBACK, 0)

    def come(message: dict) -> None:
        messages.append((time.monotonic(), message))

    with (
        closing(Page(server, live=True)) as page,
        closing(Listener(address(server), note=come)) as browser,
    ):
        builder = SimulationBuilder(scenario)
        live_page = LivePage(page, out, builder)
        off = False

        def hear(event: Event) -> None:
            nonlocal off
            if isinstance(event, ViewStored):
                off = event.index // BLOCK % 2 == 1
            if not (off and isinstance(event, ViewStored | JointSample)):
                live_page.hear(event)

        def note(event: ViewStored) -> None:
            stored[event.index] = time.monotonic()

        observers = [
            Observer(hear, joints_hz=10.0, waiting=64),
            Observer(note, (ViewStored,), lossless=True),
        ]
        run_scan(builder, out, observers)
        browser.catch_up(page)
        sent = first_sent(messages)
    close(server)
    lags = [sent[view] - at for view, at in stored.items() if view in sent and heard(view)]
    times = np.array([stored[view] for view in sorted(stored)])
    took = np.diff(times)
    # The first of a block is moved to while the page still paints the block before.
    inner = [v for v in range(1, len(times)) if v % BLOCK]
    without = np.array([took[v - 1] for v in inner if not heard(v)])
    with_page = np.array([took[v - 1] for v in inner if heard(v) and v >= BLOCK])
    # While the first block is taken the page builds the specimen, once.
    once = float(took[: BLOCK - 1].sum() - (BLOCK - 1) * with_page.mean())
    alone = len(stored) * without.mean()
    beside = len(stored) * with_page.mean() + once
    return {
        "views": len(stored),
        "stored to sent, s": {
            "median": round(float(np.median(lags)), 3),
            "largest": round(max(lags), 3),
            "of": len(lags),
        },
        "seconds a view with and without": [
            round(float(x.mean()), 4) for x in (with_page, without)
        ],
        "the same, medians": [round(float(np.median(x)), 4) for x in (with_page, without)],
        "once, s": round(once, 2),
        "slower, whole scan": round(float(beside / alone - 1), 4),
    }


def heard(view: int) -> bool:
    return view // BLOCK % 2 == 0


def run_scan(builder: SimulationBuilder, out: Path, observers: list[Observer]) -> None:
    """Acquire into a store, as a run does."""
    out.mkdir()
    folder = Folder(out)
    write_text(folder.scenario, as_yaml(builder.scenario))
    with (
        audience_of(observers) as audience,
        rig_factory("ros2", "gvxr", folder.logs, audience) as make_rig,
    ):
        acquire_to_store(builder, folder.scan, make_rig, resume=False, observers=audience)


def first_sent(messages: list) -> dict[int, float]:
    """When a browser was first sent each view's label."""
    found: dict[int, float] = {}
    for at, message in messages:
        text = message.get("updates", {}).get("text") or message.get("props", {}).get("text")
        if text and ": view " in text:
            found.setdefault(int(text.rpartition(": view ")[2].split()[0]), at)
    return found


def exported(folder: Path, page: Path) -> dict:
    words = ["view", str(folder), "--export", str(page)]
    start = time.monotonic()
    subprocess.run([sys.executable, "-m", "twinct", *words], check=True, stdout=subprocess.DEVNULL)
    seconds = time.monotonic() - start
    return {"page, MB": round(page.stat().st_size / 1e6, 2), "seconds": round(seconds, 1)}


if __name__ == "__main__":
    main()
