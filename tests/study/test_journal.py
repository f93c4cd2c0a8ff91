"""Rows outlive whoever writes them, and what is not whole is no row."""

import json
import math
import tracemalloc
from dataclasses import replace

import pytest

from twinct.core.errors import InputError, StorageError
from twinct.study import journal as journals
from twinct.study.journal import Journal, Row

ROW = Row(
    trial=3,
    key="ab12",
    axes={"noise": 0.1, "algorithm": "sart", "grid": [32, 32, 32], "iterations": None},
    seed=7,
    status="done",
    figures={"image.rmse_rel": 0.125, "image.psnr_db": None},
    seconds={"xray": 1.5},
    scan="ff00",
    report="trials/3/report.html",
)


def rows_of(count):
    return [replace(ROW, trial=number, key=f"{number:04x}") for number in range(count)]


def test_a_row_comes_back_from_its_line():
    failed = replace(ROW, status="failed", message="view 3: too far\n– “µ”", kind="TrajectoryError")
    for row in (ROW, failed):
        assert Row.from_json(row.to_json()) == row
        assert "\n" not in row.to_json()


def test_a_row_of_version_1_0_has_todays_names():
    figures = {"image.rmse_near_rel": 0.125, "image.zero.ssim_near": 0.0}
    row = replace(ROW, figures=figures, reference_material="steel")
    then = json.loads(row.to_json().replace("rmse_near", "rmse_bone").replace("m_near", "m_bone"))
    assert list(then["figures"]) == ["image.rmse_bone_rel", "image.zero.ssim_bone"]
    assert Row.from_json(json.dumps(then)) == row
    del then["reference_material"]
    assert Row.from_json(json.dumps(then)) == replace(row, reference_material="")


def test_a_figure_that_is_not_finite_is_none_and_the_line_strict_json():
    row = replace(ROW, figures={"image.psnr_db": math.inf, "image.ssim": math.nan, "a": 1.0})
    told = json.loads(row.to_json(), parse_constant=pytest.fail)
    assert told["figures"] == {"image.psnr_db": None, "image.ssim": None, "a": 1.0}


def test_rows_come_back_by_number_and_the_last_of_a_trial_counts(tmp_path):
    journal = Journal(tmp_path)
    assert journal.rows() == []
    first, second, third = rows_of(3)
    failed = replace(first, status="failed", message="no node")
    journal.append([third, failed])
    Journal(tmp_path).append([first])
    journal.append([second])
    assert journal.rows() == [first, second, third]
    assert journal.path.read_bytes().count(b"\n") == 4, "what failed before is still there"


@pytest.mark.parametrize("left", [1, 40, -1], ids=["one letter", "a part", "all but its end"])
def test_a_torn_last_line_is_no_row_and_goes_before_the_next_is_written(tmp_path, left):
    journal = Journal(tmp_path)
    first, second, third = rows_of(3)
    journal.append([first])
    whole = journal.path.read_bytes()
    with open(journal.path, "ab") as file:
        file.write((second.to_json() + "\n").encode()[:left])
    assert journal.rows() == [first] and journal.whole_bytes() == len(whole)
    journal.append([third])
    assert journal.rows() == [first, third]
    assert journal.path.read_bytes() == whole + third.to_json().encode() + b"\n"


def test_a_journal_of_one_torn_line_begins_anew(tmp_path):
    journal = Journal(tmp_path)
    journal.path.write_bytes(b'{"trial": 0')
    assert journal.rows() == [] and journal.whole_bytes() == 0
    journal.append([ROW])
    assert journal.rows() == [ROW]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b'{"trial": 0', "delimiter"),
        (b"\0\0\0\0", "Expecting value"),
        (b"[]", "not a row"),
        (b'{"trial": 1, "axes": {}, "figures": {}}', "seconds is missing"),
        (ROW.to_json().replace('"key"', '"keys"').encode(), "key is missing"),
        (ROW.to_json().replace('"done"', '"lost"').encode(), "'lost' is neither done nor failed"),
        (ROW.to_json().replace('"trial":3', '"trial":"3"').encode(), "trial is not a number"),
        (b"\xff", "not UTF-8 text"),
    ],
)
def test_a_broken_line_elsewhere_is_named_with_its_file(tmp_path, line, said):
    journal = Journal(tmp_path)
    journal.append(rows_of(2))
    with open(journal.path, "ab") as file:
        file.write(line + b"\n")
    journal.append([ROW])
    with pytest.raises(InputError, match=rf"journal\.jsonl, line 3: .*({said})"):
        journal.rows()


def test_rows_are_on_the_disk_with_one_sync(tmp_path, monkeypatch):
    synced, sync = [], journals.os.fsync
    journal = Journal(tmp_path)

    def heard(descriptor):
        synced.append(journal.path.stat().st_size)
        sync(descriptor)

    monkeypatch.setattr(journals.os, "fsync", heard)
    journal.append(rows_of(5))
    size = journal.path.stat().st_size
    assert synced == [size, size], "the file, and once the folder that names it"
    journal.append(rows_of(5))
    assert synced[2:] == [2 * size]


def test_a_full_disk_is_one_message(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(journals.os, "fsync", full)
    with pytest.raises(StorageError, match="disk is full"):
        Journal(tmp_path).append([ROW])


def test_writing_leaves_nothing_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(journals.os, "fsync", lambda descriptor: None)
    journal = Journal(tmp_path)
    figures = {f"figure.{number}": 1 / 3 for number in range(40)}

    def write(numbers):
        for number in numbers:
            journal.append([replace(ROW, trial=number, key=f"{number:x}", figures=figures)])

    tracemalloc.start()
    write(range(100))
    before = tracemalloc.get_traced_memory()[0]
    write(range(100, 2000))
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 1900 * 100, "bytes a row, of 1400 that a row has"
    assert len(journal.rows()) == 2000
