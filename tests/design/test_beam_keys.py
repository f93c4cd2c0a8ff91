"""Spectrum, tube load, noise and scatter as edits of a scenario."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from twinct.design import beam_keys
from twinct.design.draft import Draft
from twinct.scenario import Scenario


@pytest.fixture
def choose(small_file: Path) -> Callable[..., Scenario]:
    draft = Draft.open(small_file)

    def change(of: Callable[..., Any], value: Any) -> Scenario:
        assert draft.scenario is not None
        draft.set(of(draft.scenario, value))
        assert draft.scenario is not None and not draft.problems
        assert not of(draft.scenario, value)  # nothing is left to change
        return draft.scenario

    return change


def test_a_tube_is_chosen_and_given_another_voltage(choose: Callable[..., Scenario]) -> None:
    seen = choose(beam_keys.of_energy, 60)
    assert beam_keys.energy_of(seen) == ("source.energy_kev", 60)
    seen = choose(beam_keys.of_spectrum, beam_keys.TUBE)
    assert beam_keys.energy_of(seen) == ("source.spectrum.kvp", beam_keys.KVP)
    assert choose(beam_keys.of_energy, 90).source.spectrum.kvp == 90  # pyright: ignore
    assert choose(beam_keys.of_spectrum, beam_keys.MONOCHROMATIC).source.energy_kev == 60


def test_tube_load_and_exposure_change_one_key_each(choose: Callable[..., Scenario]) -> None:
    source = choose(beam_keys.of_mas, 0.5).source
    assert (source.mas, source.current_ma, source.exposure_ms) == (0.5, 50, 10)
    source = choose(beam_keys.of_exposure, 20).source
    assert (source.mas, source.current_ma, source.exposure_ms) == (1.0, 50, 20)


def test_noise_and_scatter_are_switched(choose: Callable[..., Scenario]) -> None:
    choose(beam_keys.of_spectrum, beam_keys.TUBE)
    noise = choose(beam_keys.of_noise, True).detector.noise
    assert noise is not None and noise.kind == "quantum"
    assert choose(beam_keys.of_scatter, True).detector.scatter is not None
    assert choose(beam_keys.of_noise, False).detector.noise is None
    assert choose(beam_keys.of_scatter, False).detector.scatter is None


def test_a_spectrum_from_a_file_can_be_kept(
    choose: Callable[..., Scenario], tmp_path: Path
) -> None:
    (tmp_path / "beam.txt").write_text("60 1\n80 2\n100 1\n")
    own = {"kind": "file", "path": "beam.txt"}
    seen = choose(lambda now, value: {} if now.source.spectrum else {"source.spectrum": value}, own)
    assert beam_keys.spectra(seen) == (beam_keys.MONOCHROMATIC, beam_keys.TUBE, beam_keys.FILE)
    assert beam_keys.energy_of(seen) is None and not beam_keys.of_energy(seen, 60)
