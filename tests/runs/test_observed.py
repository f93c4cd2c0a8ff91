"""A run with observers: what they hear, and that nothing of the run depends on them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S

from twinct import run
from twinct.core.cached import forget
from twinct.observers import (
    Event,
    IterationDone,
    JointSample,
    Missed,
    Observer,
    PlanMade,
    StageBegan,
    ViewStored,
    audience,
)
from twinct.runs import Run
from twinct.scan import ScanStore
from twinct.scenario import Scenario


def files(store: Path) -> dict[str, bytes]:
    return {str(p.relative_to(store)): p.read_bytes() for p in store.rglob("*") if p.is_file()}


def test_observers_hear_all_and_change_nothing(
    tiny: Callable[..., Scenario],
    finished: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(audience, "LAST_WORDS_S", HANG_S)
    heard: list[Event] = []
    late: list[Event] = []
    on_disk: list[int] = []
    out = tmp_path / "out"
    all_stored = threading.Event()

    def notes(event: Event) -> None:
        heard.append(event)
        if isinstance(event, ViewStored):
            on_disk.append(ScanStore(out / "scan.zarr").acquired)
            if event.index == 9:
                all_stored.set()

    def sleeps(event: Event) -> None:
        assert all_stored.wait(HANG_S)
        late.append(event)

    def raises(event: Event) -> None:
        raise RuntimeError

    listens = Observer(notes, joints_hz=50, lossless=True)
    observers = [listens, Observer(sleeps, waiting=3), raises]
    forget("truth")  # another test may have left it
    watched = run(tiny(), out, link="local", observers=observers)
    assert files(watched.paths.scan) == files(finished.paths.scan)
    assert np.array_equal(watched.volume.array, finished.volume.array)
    assert caplog.text.count("observer raises failed") == 1

    views = [e for e in heard if isinstance(e, ViewStored)]
    assert [(e.index, e.views) for e in views] == [(k, 10) for k in range(10)]
    for event, stored in zip(views, on_disk, strict=True):
        assert stored > event.index  # the store writes first
        assert np.array_equal(event.view.transmission, finished.scan.transmission[event.index])
        with pytest.raises(ValueError, match="read-only"):
            event.view.transmission[:] = 0
    plans = [e for e in heard if isinstance(e, PlanMade)]
    stored = ScanStore(out / "scan.zarr").plan
    assert [e.plan and e.plan.digest for e in plans] == [stored and stored.digest]
    assert heard.index(plans[0]) < heard.index(views[0])
    joints = [e for e in heard if isinstance(e, JointSample)]
    seconds = finished.scan.simulated_s[-1]
    assert len(joints) == pytest.approx(50 * seconds, abs=1)
    iterations = [e for e in heard if isinstance(e, IterationDone)]
    assert iterations[-1].iteration == 2
    assert np.array_equal(iterations[-1].volume.array, finished.volume.array)
    assert {e.name for e in heard if isinstance(e, StageBegan)} >= {"plan", "views", "truth"}

    missed = [e for e in late if isinstance(e, Missed)]
    assert missed
    told = {e.index for e in late if isinstance(e, ViewStored)}
    assert told | {view for e in missed for view in e.views} == set(range(10))
