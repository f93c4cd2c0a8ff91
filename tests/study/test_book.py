"""What trials took on this machine: means, and a file that only helps."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.study.timings import TrialTimings


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_means_are_kept() -> None:
    book = TrialTimings.open()
    assert book.mean("scan") is None
    for seconds in (1.0, 3.0):
        book.add("scan", seconds)
    book.write()
    assert TrialTimings.open().mean("scan") == 2.0


def test_a_book_that_cannot_be_read_or_written_stops_nobody(cache: Path) -> None:
    cache.write_text("a file where the folder should be")
    book = TrialTimings.open()
    book.add("scan", 1.0)
    book.write()
    assert TrialTimings.open().mean("scan") is None
