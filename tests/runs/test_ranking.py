"""Each figure ranks degraded volumes as one would by eye, or declares what it does not see."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy import ndimage
from tests.support.degraded import Judged

from twinct.evaluation import IMAGE_FIGURES, Figure
from twinct.evaluation.figure import BADNESS
from twinct.evaluation.figure_kinds import BUILT_IN
from twinct.report.measured import nested

KEYS = [
    "cell={kind: gantry}",
    "reconstruction.grid={voxels: 48, voxel_mm: 2}",
    """specimen.parts=[
      {name: water, shape: {kind: cylinder, radius_mm: 44, height_mm: 90}, material: water},
      {name: ball, shape: {kind: sphere, radius_mm: 14}, position_mm: [0, -23, 0], material: bone},
      {name: pearl, shape: {kind: sphere, radius_mm: 4}, position_mm: [30, -8, 0], material: bone}
    ]""",
    "specimen.reference=ball",
    """evaluation={
      regions: [
        {name: inside, shape: {kind: sphere, radius_mm: 3}, position_mm: [30, -8, 0]},
        {name: box, shape: {kind: box, size_mm: [34, 20, 56]}, position_mm: [0, 18, 0]},
        {name: about, shape: {kind: shell, part: ball, from_mm: 0, to_mm: 6}}
      ],
      contrasts: [{region: inside, against: box}],
      mtf: [{at: ball}],
      nps: [{region: box}],
      hounsfield: [{region: about}],
      tasks: [{name: spot, signal: {kind: sphere, radius_mm: 5, contrast_rel: 0.05}, region: box}],
      streaks: [{part: ball, from_mm: 0, to_mm: 8}]
    }""",
]

NOISE = 0.015
BLURS = 1.0, 2.0, 3.0
"""Standard deviations, in voxels."""


@pytest.fixture(scope="module")
def judge() -> Judged:
    return Judged.of(KEYS)


@pytest.fixture(scope="module")
def volumes(judge: Judged) -> dict[str, dict[str, Any]]:
    """Return the figures of each volume."""

    def with_noise(make: Any = lambda volume: volume, size: float = NOISE) -> Any:
        return lambda truth, scan: make(truth) + judge.noise(size, scan)

    def then(make: Any) -> Any:
        return lambda truth, scan: make(truth + judge.noise(2 * NOISE, scan))

    def blurred(sigma: float) -> Any:
        return lambda volume: ndimage.gaussian_filter(volume, sigma)

    def shifted(voxels: float) -> Any:
        return lambda volume: ndimage.shift(volume, [voxels] * 3, order=1, mode="nearest")

    makes = {"truth": lambda truth, scan: truth, "noise": with_noise()}
    makes["more noise"] = with_noise(size=2 * NOISE)
    makes |= {f"blur {s:g}": with_noise(blurred(s)) for s in BLURS}
    makes |= {f"smooth {s:g}": then(blurred(s)) for s in BLURS}
    makes["median"] = then(lambda volume: ndimage.median_filter(volume, 3))
    makes |= {f"shift {n}": with_noise(shifted(n)) for n in (1, 2)}
    makes |= {
        f"contrast {share}": with_noise(lambda volume, share=share: share * volume)
        for share in (0.85, 0.7)
    }
    makes["empty"] = lambda truth, scan: np.float32(0)
    makes["constant"] = lambda truth, scan: truth.mean()
    return {name: judge(make) for name, make in makes.items()}


ORDERS: dict[str, list[list[str]]] = {
    "noise": [["truth", "noise", "more noise"]],
    "blur": [["noise", *(f"blur {s:g}" for s in BLURS)]],
    "smoothing": [["more noise", *(f"smooth {s:g}" for s in BLURS)], ["more noise", "median"]],
    "shift": [["noise", "shift 1", "shift 2"]],
    "contrast": [["noise", "contrast 0.85", "contrast 0.7"]],
}
"""Right orders, the best first, by what is degraded; but for smoothing, the noise is equal."""


def ranked() -> Iterator[tuple[str, Figure]]:
    """Yield the figures that rank volumes, with their dotted names."""
    names = {
        "contrasts": "inside_against_box",
        "regions": "about",
        "mtf": "ball",
        "nps": "box",
        "hounsfield": "about",
        "tasks": "spot",
        "streaks": "ball",
    }
    yield from ((one.key, one) for one in IMAGE_FIGURES if one.best)
    for kind in BUILT_IN.values():
        yield from (
            (f"{kind.name}.{names[kind.name]}.{one.key}", one) for one in kind.figures if one.best
        )


EVERY = [*ranked()]


def badness(figure: Figure, value: float | None) -> float:
    return math.nan if value is None else BADNESS[figure.best](value)


ALIKE = 5e-3
"""Difference below which values count as equal, relative, or of figures that are best at 1."""


def keeps(order: list[str], figure: Figure, name: str, volumes: dict[str, Any]) -> bool:
    """Return True if a figure is worse from volume to volume; no value is worst.

    The truth itself, without noise, has no finite value of some figures; it is left out then. A
    transfer that does not fall to a tenth within the frequencies is better than all that do.
    """
    found = [badness(figure, nested(volumes[one], name)) for one in order]
    if figure.key == "f10_per_mm":
        half = [nested(volumes[one], name.replace("f10", "f50")) for one in order]
        found = [
            -math.inf if math.isnan(value) and at is not None else value
            for value, at in zip(found, half, strict=True)
        ]
    elif order[0] == "truth" and math.isnan(found[0]):
        del found[0]
    unit = 1.0 if figure.best == "one" else 0.0
    return all(
        a + ALIKE * max(abs(b), unit) < b or (math.isnan(b) and not math.isnan(a))
        for a, b in pairwise(found)
    )


@pytest.mark.parametrize("name, figure", EVERY, ids=[name for name, _ in EVERY])
def test_a_figure_ranks_what_it_sees(name: str, figure: Figure, volumes: Any) -> None:
    assert figure.blind_to is not None, name
    wrong = {
        what
        for what, orders in ORDERS.items()
        if not all(keeps(order, figure, name, volumes) for order in orders)
    }
    values = {one: nested(volumes[one], name) for one in volumes}
    assert wrong <= set(figure.blind_to), values
    if not name.startswith("rmse_rel_by_depth"):  # one declaration for all depths
        assert wrong == set(figure.blind_to), values


@pytest.mark.parametrize("name, figure", EVERY, ids=[name for name, _ in EVERY])
@pytest.mark.parametrize("nothing", ["empty", "constant"])
def test_nothing_is_never_best(name: str, figure: Figure, nothing: str, volumes: Any) -> None:
    value = nested(volumes[nothing], name)
    if figure.without_signal == "any":
        assert value == nested(volumes["truth"], name), "it describes the object, not the volume"
    elif value is not None:
        assert badness(figure, value) > badness(figure, nested(volumes["noise"], name))
