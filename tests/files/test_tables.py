"""Tables of numbers: which lines are read, and which are refused with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.core.errors import InputError, TrajectoryError
from twinct.core.files import tables
from twinct.core.files.tables import read_columns, read_curve
from twinct.geometry import Panel
from twinct.trajectory import commanded_views
from twinct.trajectory.table import FileTrajectory


def test_blanks_commas_semicolons_and_comments(tmp_path: Path) -> None:
    (tmp_path / "t").write_bytes(b"\xef\xbb\xbf# a, b\r\n1 2\r\n\r\n3,4 # c\r\n5;6\r\n-7e1\t.5")
    assert read_columns(tmp_path / "t", 2).tolist() == [[1, 3, 5, -70], [2, 4, 6, 0.5]]


REFUSED = [
    ("1 2\n1 x\n", ":2: .*'x' is not a number"),
    *((f"1 {word}\n", ":1: .* is not a number") for word in ("1_0", "²", "٣", "0x1", "1.2.3")),
    *((f"1 {word}\n", ":1: .* must be finite") for word in ("nan", "inf", "1e999", "9" * 5000)),
    *(("1 2 3\n", ":1: expected 2 columns, found 3"), ("1\n", ":1: expected 2 columns, found 1")),
    *(("", ": the file holds no numbers"), ("# only\n", ": the file holds no numbers")),
    ("1 " + "x" * 10**6, ":1: .* is not a number"),
]


@pytest.mark.parametrize(("text", "said"), REFUSED, ids=lambda v: v[:12])
def test_what_is_no_table_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "t").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=f"^{tmp_path / 't'}{said}") as caught:
        read_columns(tmp_path / "t", 2)
    assert len(str(caught.value)) < 400


def test_other_encodings_and_long_files_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "t").write_bytes("1 2".encode("utf-16"))
    with pytest.raises(InputError, match="not UTF-8 text"):
        read_columns(tmp_path / "t", 2)
    monkeypatch.setattr(tables, "LARGEST_BYTES", 4)
    (tmp_path / "t").write_text("1 2\n3 4\n")
    with pytest.raises(InputError, match="has 8 bytes; the limit is 4"):
        read_columns(tmp_path / "t", 2)


def test_a_curve_rises(tmp_path: Path) -> None:
    (tmp_path / "t").write_text("0 1 9\n1 2 9\n1 3 9\n")
    with pytest.raises(InputError, match="the first column must rise"):
        read_curve(tmp_path / "t")


def test_all_wrong_views_are_counted(tmp_path: Path) -> None:
    section = FileTrajectory(kind="file", path=tmp_path / "views.csv")
    for line, words in (("1,2,3,1,2,3", "coincide"), ("1,2,3,1,2,1_0", "not a number")):
        section.path.write_text("\n".join(["0,0,0,1,0,0", *[line] * 500]))
        with pytest.raises(TrajectoryError, match=words) as caught:
            commanded_views(section, Panel(4, 3, 1.0, 1.0))
        told = str(caught.value).split("\n")
        assert told[0].startswith(f"{section.path}:2: ") and len(told) == 11
        assert told[-1] == "and 490 more problems"
