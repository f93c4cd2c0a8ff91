"""``twinct dose``: its table, its files, and its refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from twinct import dose, load_scenario
from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.recon.volume import Volume

BALL = {
    "name": "ball",
    "cell": {"kind": "gantry"},
    "trajectory": {"kind": "circle", "views": 4, "sod_mm": 300, "sdd_mm": 600},
    "detector": {"rows": 20, "columns": 24, "pixel_pitch_mm": 10.0},
    "source": {"energy_kev": 60.0, "photons_per_mm2_mas": 1e6, "current_ma": 50.0},
    "specimen": {
        "position_mm": [10, 0, 0],
        "parts": [
            {"name": "ball", "shape": {"kind": "sphere", "radius_mm": 40}, "material": "water"},
            {
                "name": "thyroid",
                "shape": {"kind": "sphere", "radius_mm": 8},
                "material": "water",
                "position_mm": [0, 20, 0],
            },
        ],
    },
}


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    """Return the file of a ball with a thyroid."""
    file = tmp_path / "ball.yaml"
    file.write_text(yaml.safe_dump(BALL))
    return file


def test_doses_are_printed_and_written(ball: Path, tmp_path: Path, capsys) -> None:
    """The answer for scripts is that of the file, and the map has the mean of the table."""
    words = ["dose", str(ball), "--photons", "4e4", "--voxel-mm", "4", "--json"]
    assert run_command([*words, "--out", str(tmp_path / "out")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "out" / "dose.json").read_text())
    places = told["places"]
    gray = Volume.read(tmp_path / "out" / "dose.nii")
    x, y, z = gray.grid.axes()
    inside = (x - 10) ** 2 + y[:, None] ** 2 + z[:, None, None] ** 2 < 36**2
    assert gray.array[inside].mean() == pytest.approx(places["ball"]["dose_gy"], rel=0.05)
    assert 0 < places["thyroid"]["unscattered_gy"] < places["thyroid"]["dose_gy"]
    assert told["effective_sv"] is None
    assert "thyroid" not in told["tissues_without_label"]
    assert told["reference_kerma_gy"] > places["ball"]["dose_gy"]
    # Twice the tube load, twice the doses.
    twice = dose(ball, photons=40_000, voxel_mm=4.0)
    loaded = load_scenario(ball, ["source.current_ma=100"])
    more = dose(loaded, photons=40_000, voxel_mm=4.0)
    np.testing.assert_allclose(more.path.doses, 2 * twice.path.doses)


def test_bad_numbers_are_refused(ball: Path) -> None:
    """Photons and voxels must be positive, and a place fill a voxel."""
    with pytest.raises(InputError, match="photons 0, voxel_mm 2"):
        dose(ball, photons=0)
    with pytest.raises(InputError, match="must be at least 1, and above 0"):
        dose(ball, voxel_mm=0.0)
