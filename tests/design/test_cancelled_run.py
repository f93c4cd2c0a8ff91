"""A run that is cancelled keeps each view that it has acquired, and goes on with them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S, until

from twinct.design.desk import State
from twinct.design.draft import Draft
from twinct.design.workbench import Workbench
from twinct.runs import Folder
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scan.status import views_taken

MANY = 5000
"""Views that no run takes while a few are waited for."""


@pytest.mark.process
def test_a_cancelled_run_loses_no_view(small_file: Path, tmp_path: Path) -> None:
    text = small_file.read_text(encoding="utf-8")
    text = text[: text.index("cell:")] + "cell: {kind: gantry}\n"
    small_file.write_text(text.replace("views: 12", f"views: {MANY}"), encoding="utf-8")
    with closing(Workbench(Draft.open(small_file), tmp_path / "workers")) as bench:
        bench.run("local")
        assert bench.started is not None
        path = Folder(bench.started.out).scan

        def acquired() -> set[int]:
            return views_taken(path) if path.is_dir() else set()

        until(lambda: len(acquired()) >= 3, "no view is acquired")
        seen = acquired()
        bench.cancel_run()
        assert bench.settle(HANG_S)
        assert bench.answer("run").state is State.OLD
        kept = acquired()
        assert seen <= kept and 3 <= len(kept) < MANY
        store, wanted = ScanStore(path), {}
        builder = SimulationBuilder(store.scenario)
        with closing(builder.imager()) as imager:
            place = builder.specimen.world_from_specimen
            for view in sorted(kept)[:: max(len(kept) // 5, 1)]:
                wanted[view] = imager.render(builder.requested[view], place, view)
                np.testing.assert_array_equal(store.transmission(view), wanted[view])

        def written() -> dict[Path, int]:
            arrays = (path / "transmission").rglob("*")
            return {file: file.stat().st_mtime_ns for file in arrays if file.is_file()}

        before = written()
        bench.run("local")
        assert bench.started.out == path.parent
        until(lambda: len(acquired()) > len(kept), "the run does not go on")
        bench.cancel_run()
        assert bench.settle(HANG_S)
        now = written()
        assert len(before) >= len(kept)
        assert {file: now[file] for file in before if file in now} == before
        for view, image in wanted.items():
            np.testing.assert_array_equal(ScanStore(path).transmission(view), image)
