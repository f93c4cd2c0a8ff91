"""Verdicts on the toolbox's results, compared with the requirements of the tests."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.ctsimu.suite.cases import COVERAGE_SAMPLES


@dataclass(frozen=True)
class SuiteVerdict:
    """One figure of merit of a test; ``passed`` is None if it is only reported."""

    test: str
    what: str
    required: str
    measured: str
    passed: bool | None


def verdicts(test: str, results: Path) -> list[SuiteVerdict]:
    """Read the results of a test from the toolbox's output folder."""
    return _READERS[test](results)


def _noise(results: Path) -> list[SuiteVerdict]:
    verdicts = []
    for nominal in (100, 250):
        text = (results / f"2D-FB-1_SNR{nominal}_summary.txt").read_text()
        snr = _number(text, r"Overall projection SNR:\s+(\S+)")
        mean = _number(text, r"Mean grey value:\s+(\S+)")
        measured = f"{snr:.2f} (mean {mean:.0f})"
        good = abs(snr / nominal - 1) <= 0.02
        verdicts.append(SuiteVerdict("2D-FB-1", "SNR", f"{nominal} within 2 %", measured, good))
    return verdicts


def _distance(results: Path) -> list[SuiteVerdict]:
    worst = float(np.abs(np.loadtxt(results / "2D-FB-2_summary.txt")[:, 4]).max())
    what = "largest deviation from the analytic profile"
    return [SuiteVerdict("2D-FB-2", what, "at most 0.1 %", f"{worst:.3f} %", worst <= 0.1)]


def _coverage(results: Path) -> list[SuiteVerdict]:
    text = (results / "2D-WE-2_summary.txt").read_text()
    ours, both = _number(text, r"measured image:\s+(\d+)"), _number(text, r"both images:\s+(\d+)")
    partly = _number(text, r"analytical image:\s+(\d+)")
    ratio, rmsd = _number(text, r"analytical\):\s+([\d.]+)%"), _number(text, r"([\d.]+) GV")
    extra = 100 * (ours - both) / partly
    figures = (
        ("r", "at least 95 %", f"{ratio:.2f} %", ratio >= 95),
        ("RMSD", "at most 600 of 60000", f"{rmsd:.1f}", rmsd <= 600),
        ("extra pixels", "at most 1 %", f"{extra:.2f} %", extra <= 1),
    )
    sampled = f", {COVERAGE_SAMPLES} x {COVERAGE_SAMPLES} samples a pixel"
    return [
        SuiteVerdict("2D-WE-2", what + sampled, required, measured, passed)
        for what, required, measured, passed in figures
    ]


def _spots(results: Path) -> list[SuiteVerdict]:
    verdicts = []
    for key, sigma_um, mtf20 in (("spot1", 9.579, 29.852), ("spot2", 24.552, 11.770)):
        text = (results / f"2D-WE-1_{key}_summary.txt").read_text()
        sigma = 1000 * _number(text, r"measured:\s+sigma.*\n\s+\[mm\] = (\S+)")
        frequency = _number(text, r"MTF20 measured:.*\n\s+\[cycles/mm\] = (\S+)")
        verdicts.append(_near("2D-WE-1", f"{key}: LSF sigma", sigma, sigma_um, "um"))
        verdicts.append(_near("2D-WE-1", f"{key}: MTF20", frequency, mtf20, "/mm"))
    return verdicts


def _wires(results: Path) -> list[SuiteVerdict]:
    verdicts = []
    for key, nominal_um in (("SR75", 75.0), ("SR150", 150.0)):
        text = (results / f"2D-DW-1_{key}_results.txt").read_text()
        value_um = 1000 * _number(text, r"iSRb: (\S+)")
        verdicts.append(_near("2D-DW-1", f"{key}: iSRb", value_um, nominal_um, "um"))
    return verdicts


def _near(test: str, what: str, value: float, wanted: float, unit: str) -> SuiteVerdict:
    """Return the verdict on a figure with a tolerance of 5 %."""
    off = value / wanted - 1
    measured = f"{value:.3f} {unit} ({100 * off:+.2f} %)"
    return SuiteVerdict(test, what, f"{wanted:g} {unit} within 5 %", measured, abs(off) <= 0.05)


def _scintillators(results: Path) -> list[SuiteVerdict]:
    names, ours = _table(results / "2D-SW-1_all_GV_ratios_to_Det1.txt")
    reference = np.loadtxt(results / "2D-SW-1_all_MCprimary_reference_ratios.txt")[:, 1:]
    verdicts = []
    for column, name in enumerate(names):
        if name.startswith("D1"):
            continue
        mean, below, above = reference[:, 3 * column : 3 * column + 3].T
        deviation = ours[:, column] - mean
        allowed = np.where(deviation > 0, above, below) + 0.02 * mean
        worst = float((np.abs(deviation) / allowed).max())
        relative = float(np.abs(deviation / mean).max())
        required, passed = "reported", None
        if name.endswith("_Al_50"):
            required, passed = "Monte Carlo uncertainty + 2 %", worst <= 1
        elif name.endswith("_Fe_100"):  # see IRON_STEPS_MM
            required = "nothing: the steps were taken from this reference"
        what = f"{name}: ratios to D1, primary radiation"
        measured = f"largest deviation {100 * relative:.2f} %, {worst:.2f} of what is allowed"
        verdicts.append(SuiteVerdict("2D-SW-1", what, required, measured, passed))
    return verdicts


def _filters(results: Path) -> list[SuiteVerdict]:
    verdicts = []
    for key in ("Al", "AlCu", "Fe", "FeCu"):
        worst = np.abs(np.loadtxt(results / f"2D-SW-2_{key}_ratios.txt")[:, 6]).max()
        measured = f"largest deviation {100 * worst:.2f} %"
        verdicts.append(
            SuiteVerdict("2D-SW-2", f"{key}: step ratios, primary", "reported", measured, None)
        )
    return verdicts


def _overlaps(results: Path) -> list[SuiteVerdict]:
    verdicts = []
    for key in ("Al_Al", "Al_Ti"):
        text = (results / f"2D-SW-3_{key}_summary.txt").read_text()
        count = int(_number(text, r"anomalies: (\d+)"))
        pixels = int(_number(text, r"treated pixels: (\d+)"))
        measured = f"{count} in {pixels} pixels"
        verdicts.append(SuiteVerdict("2D-SW-3", f"{key}: anomalies", "0", measured, count == 0))
    return verdicts


def _number(text: str, pattern: str) -> float:
    match = re.search(pattern, text)
    if match is None:
        raise ValueError(f"the toolbox's result does not match {pattern!r}")
    return float(match[1])


def _table(path: Path) -> tuple[list[str], np.ndarray]:
    lines = path.read_text().splitlines()
    rows = [[float(cell) for cell in line.split("\t")[1:]] for line in lines[1:]]
    return lines[0].split("\t")[1:], np.array(rows)


_READERS: dict[str, Callable[[Path], list[SuiteVerdict]]] = {
    "2D-FB-1": _noise,
    "2D-FB-2": _distance,
    "2D-DW-1": _wires,
    "2D-WE-1": _spots,
    "2D-WE-2": _coverage,
    "2D-SW-1": _scintillators,
    "2D-SW-2": _filters,
    "2D-SW-3": _overlaps,
}
