"""Arrays kept on disk: made once, made again where they are other or cannot be read."""

from pathlib import Path

import numpy as np
import pytest

from twinct.core.disk_cache import MOST_FILES, made_once


class Maker:
    """Counts how often it makes its arrays."""

    def __init__(self):
        self.made = 0

    def __call__(self):
        self.made += 1
        return {"one": np.arange(5.0), "two": np.arange(6, dtype=np.int32)}


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "twinct"


def test_arrays_are_made_once_for_their_inputs(folder):
    make = Maker()
    for _ in range(2):
        found = made_once("thing", [b"a", b"b"], make)
        np.testing.assert_array_equal(found["one"], np.arange(5.0))
        assert found["two"].dtype == np.int32
    assert make.made == 1
    made_once("thing", [b"ab"], make)
    assert make.made == 2


@pytest.mark.parametrize("text", [b"", b"no archive", None])
def test_a_file_that_cannot_be_read_is_made_again(folder, text):
    make = Maker()
    made_once("thing", [b"a"], make)
    (path,) = folder.glob("*.npz")
    path.write_bytes(path.read_bytes()[:-40] if text is None else text)
    for _ in range(2):
        np.testing.assert_array_equal(made_once("thing", [b"a"], make)["one"], np.arange(5.0))
    assert make.made == 2


def test_nothing_is_kept_where_no_folder_can_be(folder):
    folder.write_text("a file")
    make = Maker()
    for _ in range(2):
        assert made_once("thing", [b"a"], make)["one"].size == 5
    assert make.made == 2


def test_old_files_go(folder):
    for n in range(MOST_FILES + 3):
        made_once("thing", [bytes([n])], Maker())
    assert len(list(folder.iterdir())) == MOST_FILES


def test_a_user_without_a_home_gets_the_arrays(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    maker = Maker()
    for _ in range(2):
        assert np.array_equal(made_once("thing", [b"input"], maker)["one"], np.arange(5.0))
    assert maker.made == 2
