"""Cost of servos in the image: clocks apart, and joints that vibrate or sag, beside exact arms.

    python benchmarks/bench_servo.py [--scenario demo]

Each line is one run, without noise of the reported poses: errors of the image of the isocentre, the
volume's RMSE, and the duration.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import twinct
from twinct.scenario import load_scenario

VIBRATES = [f"uncertainty.servos.{side}.resonance_hz=9" for side in ("source", "detector")]
CASES: dict[str, list[str]] = {
    "exact": [],
    "clock 1 ms": ["uncertainty.servos.source.clock_ms=1"],
    "clock 5 ms": ["uncertainty.servos.source.clock_ms=5"],
    "clock 20 ms": ["uncertainty.servos.source.clock_ms=20"],
    "sag": ["uncertainty.arms.windup_deg=0.1"],
    "sag of the source arm": ["uncertainty.arms.source.windup_deg=0.1"],
    "9 Hz, moving": VIBRATES,
    "9 Hz, settled": [*VIBRATES, "motion.trigger=settled"],
    "9 Hz, settled, 1 s": [*VIBRATES, "motion.trigger=settled", "motion.settle_s=1.0"],
}


WORDS = ("rmse", "isocentre", "duration")
"""Parts of the names of figures that are printed."""


def flat(data: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield all numbers of nested figures by dotted names."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from flat(value, f"{name}.{key}" if name else key)
    elif isinstance(data, int | float):
        yield name, float(data)


def main() -> None:
    """Run every case."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", default="demo")
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    arguments = parser.parse_args()
    quiet = ["uncertainty.source.sigma_mm=0", "uncertainty.detector.sigma_mm=0"]
    for name in arguments.cases:
        with tempfile.TemporaryDirectory() as folder:
            scenario = load_scenario(arguments.scenario, [*quiet, *CASES[name]])
            twinct.run(scenario, Path(folder) / "run", link="local")
            found = flat(json.loads((Path(folder) / "run" / "metrics.json").read_text()))
        told = ", ".join(f"{k} {v:.4g}" for k, v in found if any(w in k for w in WORDS))
        print(f"{name}: {told}", flush=True)


if __name__ == "__main__":
    main()
