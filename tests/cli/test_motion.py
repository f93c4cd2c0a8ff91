"""``twinct motion``: what it writes and refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.cli import run_command

SCENARIO = """
trajectory: {kind: arc, views: 3, longitude_range_deg: 6}
specimen: {parts: [{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 8}}]}
"""


def test_a_plan_is_written_and_nothing_is_overwritten(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "s.yaml").write_text(SCENARIO)
    command = ["motion", str(tmp_path / "s.yaml"), "--to", "csv", "--out", str(tmp_path / "out")]
    assert run_command(command) == 0
    assert "3 views in" in capfd.readouterr().out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"plan.csv", "triggers.csv"}
    assert run_command(command) == 2
    assert "exists already" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("key", "to", "told"),
    [
        ("cell={kind: gantry}", "csv", "cell.kind: a gantry has no arms to move"),
        ("motion.scheme=reactive", "csv", "motion.scheme: reactive has no plan"),
        ("seed=1", "krl", "--to krl: unknown"),
    ],
)
def test_what_has_no_plan_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], key: str, to: str, told: str
) -> None:
    (tmp_path / "s.yaml").write_text(SCENARIO)
    out = tmp_path / "out"
    asked = ["motion", str(tmp_path / "s.yaml"), "--to", to, "--out", str(out), "--set", key]
    assert run_command(asked) == 2
    assert told in capfd.readouterr().err
    assert not out.exists()
