"""Cases 2, 4.2 and 5 of AAPM TG-195 with few photons, as ``benchmarks/bench_tg195.py`` has them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from twinct.transport import Simulation

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("TG195_DATA", ROOT.parent / "shared/data/tg195"))
MOST_ERRORS = 4.0
MOST_MEAN = 0.01

pytestmark = [
    pytest.mark.data,
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason="needs the report's results (TG195_DATA)"),
]


@pytest.fixture(scope="module")
def bench():
    """The benchmark's module."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import bench_tg195

    yield bench_tg195
    sys.path.remove(str(ROOT / "benchmarks"))


def judge(bench, entries, figure) -> None:
    """Fail if an entry or the mean is too far from the codes' median."""
    known = bench.references(DATA)
    off = np.array([mean / known[key].median - 1 for key, (mean, _) in entries.items()])
    own = np.array([error / known[key].median for key, (_, error) in entries.items()])
    combined = np.hypot(own, [known[key].error for key in entries])
    # Entries count alike as far as they are surer than the tolerance.
    mean = np.average(off, weights=1 / (own**2 + MOST_MEAN**2))
    worst = int(np.argmax(abs(off) / combined))
    figure(
        f"{len(entries)} entries: mean {mean:+.2%}; worst {', '.join(list(entries)[worst])}: "
        f"{off[worst]:+.2%}, {abs(off[worst]) / combined[worst]:.1f} standard errors"
    )
    assert (abs(off) <= MOST_ERRORS * combined).all()
    assert abs(mean) <= MOST_MEAN


@pytest.mark.parametrize("case, photons", [("2", 200_000), ("4.2", 400_000)])
def test_boxes_and_rods(bench, figure, case: str, photons: int) -> None:
    """Energies in boxes of a slab, and in rods of a cylinder, are those of the four codes."""
    entries = {}
    for found in bench.CASES[case](photons, DATA):
        # The codes' own means over all angles are not those of their angles (docs/validation.md).
        entries |= {key: pair for key, pair in found.items() if key[1] != "Continuous"}
    judge(bench, entries, figure)


def test_organs(bench, figure) -> None:
    """Energies in the organs of a trunk, from two sides, are those of the four codes."""
    _, body = bench.phantom(DATA)
    entries = {}
    for name, angle in (("56.4 keV", 0), ("120 kVp", 225)):
        scores = Simulation(body, bench.beam_5(name, angle), dose=False).run(20_000, 40, seed=5)
        means, errors = (1000 * part for part in scores.label_energy())
        entries |= {
            ("Case 5", organ, name, str(angle)): (float(means[n]), float(errors[n]))
            for n, organ in bench.ORGAN_NAMES.items()
        }
    judge(bench, entries, figure)
