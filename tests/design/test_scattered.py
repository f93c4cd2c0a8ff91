"""The scatter in a preview is that of the library's imager."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S

from twinct.core.errors import InputError
from twinct.design.bench import Bench
from twinct.design.desk import State
from twinct.design.draft import Draft
from twinct.design.questions import preview
from twinct.design.scattered import PHOTONS, Scatter
from twinct.design.workbench import Workbench
from twinct.scan import SimulationBuilder
from twinct.scenario import ScenarioText, load_scenario

SECTION = "scatter: {kind: monte_carlo, voxel_mm: 8}"


@pytest.fixture
def scattering(small_file: Path) -> ScenarioText:
    text = small_file.read_text(encoding="utf-8")
    small_file.write_text(text.replace("pixel_pitch_mm: 6", f"pixel_pitch_mm: 6, {SECTION}"))
    return ScenarioText(small_file, small_file.read_text(encoding="utf-8"))


@pytest.fixture
def bench() -> Iterator[Bench]:
    with closing(Bench()) as made:
        yield made


def test_scatter_is_what_an_imager_adds(scattering: ScenarioText, bench: Bench) -> None:
    found = Scatter(scattering, 0).answered(bench)
    plain = preview(load_scenario(scattering))
    shown = {"photons": PHOTONS, "views": 12, "kind": "monte_carlo", "voxel_mm": 8}
    images = []
    for scenario in (plain.with_({"detector.scatter": shown}), plain):
        builder = SimulationBuilder(scenario)
        with closing(builder.imager()) as imager:
            place = builder.specimen.world_from_specimen
            images.append(imager.render(builder.requested[0], place))
    assert found.mean() > 0.005
    np.testing.assert_allclose(found, images[0] - images[1], atol=2e-6)


def test_scatter_of_a_view_is_kept(
    scattering: ScenarioText, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Scatter(scattering, 3).answered(bench)
    assert not np.array_equal(first, Scatter(scattering, 6).answered(bench))
    monkeypatch.setattr("twinct.transport.Simulation.run", None)
    other = scattering.text.replace("iterations: 2", "iterations: 3")
    assert Scatter(ScenarioText(scattering.path, other), 3).answered(bench) is first
    with pytest.raises(TypeError):
        Scatter(scattering, 4).answered(bench)


def test_a_scenario_without_scatter_is_refused(small_file: Path, bench: Bench) -> None:
    source = ScenarioText(small_file, small_file.read_text(encoding="utf-8"))
    with pytest.raises(InputError, match="no scatter to show"):
        Scatter(source).answered(bench)


@pytest.mark.process
def test_scatter_follows_the_preview(scattering: ScenarioText, tmp_path: Path) -> None:
    with closing(Workbench(Draft.open(scattering.path), tmp_path / "workers")) as bench:
        bench.ask_for_scatter()  # no image is there
        assert bench.answer("scatter").state is State.UNASKED
        bench.begin()
        assert bench.settle(HANG_S)
        shown = bench.answer("image").question
        assert bench.scatter_in(shown).state is State.UNASKED
        bench.ask_for_scatter()
        assert bench.settle(HANG_S)
        assert bench.scatter_in(shown).value.mean() > 0.005

        bench.look(5)
        assert bench.settle(HANG_S)
        assert bench.scatter_in(bench.answer("image").question).value is None
        bench.ask_for_scatter()
        bench.cancel()
        assert bench.settle(HANG_S)
        assert bench.scatter_in(bench.answer("image").question).value is None
        bench.ask_for_scatter()
        assert bench.settle(HANG_S)
        assert bench.scatter_in(bench.answer("image").question).state is State.FRESH
