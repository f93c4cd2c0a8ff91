"""No figure rewards a volume in which nothing can be seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage
from tests.support.degraded import Judged

from twinct.evaluation import IMAGE_FIGURES, Figure, figure_kinds
from twinct.evaluation.figure import BADNESS
from twinct.evaluation.figure_kinds import BUILT_IN
from twinct.report.measured import nested

KEYS = [
    "cell={kind: gantry}",
    "reconstruction.grid={voxels: 64, voxel_mm: 1.5}",
    """specimen.parts=[
      {name: water, shape: {kind: cylinder, radius_mm: 42, height_mm: 90}, material: water},
      {name: ball, shape: {kind: sphere, radius_mm: 12}, position_mm: [20, 0, 0], material: bone}
    ]""",
    """evaluation={
      regions: [
        {name: lesion, shape: {kind: sphere, radius_mm: 6}, position_mm: [20, 0, 0]},
        {name: box, shape: {kind: box, size_mm: [30, 14, 40]}, position_mm: [0, 27, 0]},
        {name: air, shape: {kind: box, size_mm: [8, 60, 60]}, position_mm: [-47, 0, 0]}
      ],
      contrasts: [{region: lesion, against: box}],
      mtf: [{at: ball}],
      nps: [{region: box}, {region: air}],
      hounsfield: [{region: box}],
      tasks: [{name: spot, signal: {kind: sphere, radius_mm: 4, contrast_rel: 0.1}, region: box}],
      streaks: [{part: ball, from_mm: 2, to_mm: 8}]
    }""",
]

VolumeFacts = dict[str, Any]


@pytest.fixture(scope="module")
def judged() -> Callable[[Any], VolumeFacts]:
    """Return the figures, as in metrics.json, of volumes that a function makes of the truth."""
    judge = Judged.of(KEYS)
    facts = {"grid": judge.truth.grid, "mu_reference": judge.truth.mu_reference}

    def told(make: Callable[[Any], Any]) -> VolumeFacts:
        return judge(lambda volume, scan: make(SimpleNamespace(volume=volume, scan=scan, **facts)))

    return told


def noise(truth: Any, size: float) -> Any:
    drawn = np.random.default_rng([7, truth.scan]).standard_normal(truth.grid.shape)
    return (size * truth.mu_reference * drawn).astype(np.float32)


@pytest.fixture(scope="module")
def decent(judged: Any) -> VolumeFacts:
    """Blurred by a voxel, with noise and bands."""

    def make(truth: Any) -> Any:
        bands = 0.05 * truth.mu_reference * np.sin(np.arange(truth.grid.shape[1]) / 3)[:, None]
        return ndimage.gaussian_filter(truth.volume, 1.0) + noise(truth, 0.05) + bands

    return judged(make)


NOTHING: dict[str, Callable[[Any], Any]] = {
    "empty": lambda truth: np.float32(0),
    "the reference material": lambda truth: np.float32(truth.mu_reference),
    "the mean": lambda truth: truth.volume.mean(),
    "below zero": lambda truth: np.float32(-1),
    "almost constant": lambda truth: 0.5 * truth.mu_reference + noise(truth, 1e-5),
    "a trace of the truth": lambda truth: 0.01 * truth.volume,
    "15 % of the truth": lambda truth: 0.15 * truth.volume + noise(truth, 0.01),
    "noise alone": lambda truth: noise(truth, 0.02),
}


def figures(told: VolumeFacts) -> Iterator[tuple[str, Figure]]:
    """Yield the dotted names of all built-in figures among those of a volume."""
    yield from ((one.key, one) for one in IMAGE_FIGURES)
    for kind in BUILT_IN.values():
        assert told[kind.name], f"the scenario lacks {kind.name}"
        for name in told[kind.name]:
            yield from ((f"{kind.name}.{name}.{one.key}", one) for one in kind.figures)


def test_each_figure_says_what_is_good_and_what_nothing_scores() -> None:
    of_kinds = (one for kind in figure_kinds().values() for one in kind.figures)
    for one in (*IMAGE_FIGURES, *of_kinds):
        assert one.good and one.without_signal in ("null", "worse", "any"), one.key


def test_a_decent_volume_has_all_figures(decent: VolumeFacts) -> None:
    missing = [name for name, _ in figures(decent) if nested(decent, name) is None]
    assert missing == []
    assert len(decent["mtf"]["ball"]["mtf"]) > 9
    assert decent["signal_rel"] == pytest.approx(1, abs=0.1)  # its blur


@pytest.mark.parametrize("name", NOTHING)
def test_nothing_scores_no_better_than_a_decent_volume(
    judged: Any, decent: VolumeFacts, name: str
) -> None:
    told = judged(NOTHING[name])
    assert abs(told["signal_rel"]) < (0.16 if name.startswith("15") else 0.02)
    for key, one in figures(decent):
        value, usual = nested(told, key), nested(decent, key)
        match one.without_signal:
            case "null":
                assert value is None, key
            case "worse":
                worse = BADNESS[one.best]
                assert one.best and value is not None, key
                assert worse(value) > worse(usual), key
            case _:
                assert not one.best or value == usual, key
    assert "mtf" not in told["mtf"]["ball"] and "nps_mm3" not in told["nps"]["box"]


def test_without_the_rule_nothing_would_win(
    judged: Any, decent: VolumeFacts, monkeypatch: Any
) -> None:
    """The rule is needed: so many figures of an empty volume are better than decent ones."""
    for module in ("image", "figure_kind"):
        monkeypatch.setattr(f"twinct.evaluation.{module}.has_signal", lambda *_: True)
    better: list[str] = []
    for name in ("empty", "the reference material"):
        told = judged(NOTHING[name])
        for key, one in figures(decent):
            value, usual = nested(told, key), nested(decent, key)
            if value is not None and one.best and math.isfinite(value):
                better += [key] * (BADNESS[one.best](value) < BADNESS[one.best](usual))
    assert {"nps.box.noise_rel", "streaks.ball.streak_rel", "mean_reference_rel"} <= {*better}
    assert not {key for key, one in figures(decent) if one.without_signal != "null"} & {*better}


def test_signal_is_what_is_surely_nearer_to_the_truth_than_to_a_constant(judged: Any) -> None:
    """15 % of the truth had one before; noise may leave open what half of the truth has."""

    def told(share: float, size: float) -> VolumeFacts:
        return judged(lambda truth: share * truth.volume + noise(truth, size))

    assert told(0.15, 0.01)["ssim"] is None and told(0.15, 0.01)["nps"]["box"]["noise_rel"] is None
    quiet, loud = told(0.51, 0.01), told(0.51, 3.0)
    assert quiet["ssim"] is not None and 0.505 < quiet["signal_rel"] < 0.515
    assert quiet["signal_error_rel"] < 0.001 < loud["signal_error_rel"]
    assert loud["ssim"] is None, "its interval holds a half"
    for share in (0.45, 0.55):
        nearer_to_truth = abs(1 - share) < abs(share)
        assert (told(share, 0.01)["ssim"] is not None) == nearer_to_truth
