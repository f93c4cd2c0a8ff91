"""What is said of the disk after one trial, against what a study takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from twinct.study import dry_run, run_study
from twinct.study.estimate import bytes_below

from .conftest import SCENARIO

WITHIN = 0.1
"""Share of what it takes."""

pytestmark = [pytest.mark.process, pytest.mark.tutorial]


def study(keep: str, seeds: list[int], relaxations: list[float]) -> dict[str, Any]:
    """Scans that differ in their noise, in voxels enough that volumes count."""
    return {
        "scenario": SCENARIO,
        "set": {
            "detector": {"columns": 240, "rows": 180, "pixel_pitch_mm": 1.3},
            "detector.noise": {"kind": "snr", "snr": 100.0},
            "reconstruction.grid": {"voxels": 96, "voxel_mm": 1.66},
        },
        "axes": [
            {"key": "seed", "label": "noise", "values": seeds},
            {"key": "reconstruction.relaxation", "values": relaxations},
        ],
        "keep": keep,
    }


@pytest.mark.parametrize("keep", ["figures", "everything"])
def test_the_disk_is_known_after_one_trial(keep: str, warm, tmp_path: Path) -> None:
    run_study(study(keep, [0], [0.3]), tmp_path / "one")
    many = study(keep, [1, 2], [0.2, 0.4])
    said = dry_run(many, tmp_path / "many").estimate
    run_study(many, tmp_path / "many")
    taken = bytes_below([tmp_path / "many"])
    assert said.measured and (said.trials, said.scans) == (4, 2)
    assert said.disk_bytes == pytest.approx(taken, rel=WITHIN)


def test_a_file_with_two_names_takes_its_bytes_once(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x" * 1000)
    (tmp_path / "b").hardlink_to(tmp_path / "a")
    (tmp_path / "c").write_bytes(b"y" * 10)
    assert bytes_below([tmp_path]) == 1010
    assert bytes_below([tmp_path / "a", tmp_path / "c"]) == 1010
