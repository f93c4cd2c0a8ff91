"""What may be turned: by the keys, and where nobody asked for axes."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.robots.motion.roll import roll_free
from twinct.scenario import GaussianSpot, Motion, Source
from twinct.trajectory import ArcTrajectory, FileTrajectory

ARC = ArcTrajectory(kind="arc", views=3)
ROUND = Source(focal_spot=GaussianSpot(kind="gaussian", sigma_mm=0.1))
OVAL = Source(focal_spot=GaussianSpot(kind="gaussian", sigma_mm=(0.1, 0.2)))


def table(tmp_path: Path, row: str) -> FileTrajectory:
    path = tmp_path / "views.csv"
    path.write_text(f"{row}\n", encoding="utf-8")
    return FileTrajectory(kind="file", path=path)


def test_a_trajectory_with_axes_leaves_nothing_free() -> None:
    assert roll_free(Motion(), ARC, Source()) == (False, False)


@pytest.mark.parametrize(("source", "free"), [(Source(), True), (ROUND, True), (OVAL, False)])
def test_without_axes_the_panel_is_free_and_the_source_if_round(
    tmp_path: Path, source: Source, free: bool
) -> None:
    assert roll_free(Motion(), table(tmp_path, "300,0,0,-300,0,0"), source) == (free, True)


def test_a_table_with_axes_leaves_nothing_free(tmp_path: Path) -> None:
    section = table(tmp_path, "300,0,0,-300,0,0,0,1,0,0,0,1")
    assert roll_free(Motion(), section, Source()) == (False, False)


def test_keys_have_the_last_word(tmp_path: Path) -> None:
    free = Motion(source_roll="free", detector_roll="fixed")
    assert roll_free(free, table(tmp_path, "300,0,0,-300,0,0"), OVAL) == (True, False)
    assert roll_free(Motion(detector_roll="free"), ARC, Source()) == (True, True)
