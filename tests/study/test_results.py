"""The table of results: alike whether made from the journal or read from its file."""

import os
import sys
from dataclasses import replace

import numpy as np
import pytest

import twinct
from twinct.core.errors import InputError, MissingExtraError
from twinct.study import results
from twinct.study.journal import Journal, Row
from twinct.study.results import load_results, results_table, write_results

pd = pytest.importorskip("pandas")
pytest.importorskip("pyarrow")


def row(trial, status="done", **changes):
    own = {
        "trial": trial,
        "key": f"{trial:04x}",
        "axes": {"noise": 0.1 * trial, "iterations": 3 + trial, "algorithm": "sart"},
        "seed": trial,
        "status": status,
        "figures": {"image.rmse_rel": 0.1 + trial},
        "seconds": {"xray": 1.5},
        "report": f"trials/{trial}",
    }
    return Row(**own | changes)


ROWS = [
    row(0, axes={"noise": 0, "iterations": 3, "algorithm": "sart", "grid": [8, 8], "on": True}),
    row(1, axes={"noise": 0.1, "iterations": None, "algorithm": "fdk", "grid": "all"}),
    row(2, "failed", figures={}, seconds={}, seed=None, message="out of reach", kind="Nothing"),
    row(3, figures={"image.rmse_rel": None, "image.ssim": 0.5}, seconds={"other": 2.0}),
]


@pytest.fixture
def study(tmp_path):
    Journal(tmp_path).append(ROWS)
    return tmp_path


def test_a_line_for_each_trial_with_columns_of_one_type():
    table = results_table(ROWS[::-1])
    assert {name: str(kind) for name, kind in table.dtypes.items()} == {
        "trial": "int64",
        "algorithm": "string",
        "grid": "string",
        "iterations": "Int64",
        "noise": "float64",
        "on": "boolean",
        "seed": "Int64",
        "status": "string",
        "image.rmse_rel": "float64",
        "image.ssim": "float64",
        "seconds.xray": "float64",
        "seconds.other": "float64",
        "reference_material": "string",
        **dict.fromkeys(("message", "kind", "scan", "report", "key"), "string"),
    }
    assert list(results_table(ROWS).columns[:4]) == ["trial", "noise", "iterations", "algorithm"]
    assert list(table["trial"]) == [0, 1, 2, 3]
    np.testing.assert_array_equal(table["image.rmse_rel"], [0.1, 1.1, np.nan, np.nan])
    assert table["grid"].tolist()[:2] == ["[8, 8]", "all"] and table["grid"].isna()[2]
    assert table["iterations"].isna().tolist() == [False, True, False, False]
    assert table["message"].tolist() == ["", "", "out of reach", ""]


@pytest.mark.parametrize(
    ("values", "kind", "told"),
    [
        ([1, 2], "Int64", [1, 2]),
        ([1, 2.5], "float64", [1.0, 2.5]),
        ([1, "two"], "string", ["1", "two"]),
        ([True, 1], "string", ["true", "1"]),
        ([{"kind": "fdk"}, "é"], "string", ['{"kind": "fdk"}', "é"]),
    ],
)
def test_an_axis_of_several_kinds_is_text(tmp_path, values, kind, told):
    rows = [row(k, axes={"axis": value}) for k, value in enumerate(values)]
    Journal(tmp_path).append(rows)
    write_results(tmp_path, rows)
    column = load_results(tmp_path)["axis"]
    assert str(column.dtype) == kind and column.tolist() == told


def test_a_name_that_is_taken_is_refused():
    for name in ("seed", "image.rmse_rel", "seconds.xray"):
        with pytest.raises(InputError, match=f"axis '{name}': another column"):
            results_table([row(0, axes={name: 1})])


def test_the_file_holds_what_the_journal_does(study, monkeypatch):
    made = load_results(study)
    pd.testing.assert_frame_equal(made, results_table(ROWS))
    write_results(study, Journal(study).rows())
    assert {p.name for p in study.iterdir()} == {"journal.jsonl", "results.parquet"}
    monkeypatch.setattr(results, "results_table", None)  # so that it must be the file
    pd.testing.assert_frame_equal(twinct.load_results(str(study)), made)


def test_a_folder_may_have_a_name_that_is_no_utf_8(tmp_path, monkeypatch):
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    Journal(folder).append(ROWS)
    write_results(folder, ROWS)
    monkeypatch.setattr(results, "results_table", None)
    assert len(load_results(folder)) == len(ROWS)


def test_rows_that_came_after_the_file_are_seen(study):
    write_results(study, ROWS)
    again = replace(ROWS[2], status="done", message="", figures={"image.ssim": 0.25})
    Journal(study).append([again, row(4)])
    table = load_results(study)
    assert table["status"].tolist() == ["done"] * 5 and table["image.ssim"][2] == 0.25


def test_a_torn_line_makes_no_file_old(study, monkeypatch):
    write_results(study, ROWS)
    with open(study / "journal.jsonl", "a") as file:
        file.write('{"trial"')
    monkeypatch.setattr(results, "results_table", None)
    assert len(load_results(study)) == 4


@pytest.mark.parametrize("keep", [0, 300])
def test_a_damaged_file_is_made_anew_from_the_journal(study, keep):
    write_results(study, ROWS)
    file = study / "results.parquet"
    file.write_bytes(file.read_bytes()[:keep])
    pd.testing.assert_frame_equal(load_results(study), results_table(ROWS))


def test_a_write_that_fails_leaves_the_file_that_was(study, monkeypatch):
    import pyarrow.parquet

    write_results(study, ROWS)
    before = (study / "results.parquet").read_bytes()

    def torn(table, where):
        where.write(b"PAR1")
        raise KeyboardInterrupt

    monkeypatch.setattr(pyarrow.parquet, "write_table", torn)
    with pytest.raises(KeyboardInterrupt):
        write_results(study, ROWS[:1])
    assert (study / "results.parquet").read_bytes() == before
    assert {p.name for p in study.iterdir()} == {"journal.jsonl", "results.parquet"}


def test_ten_thousand_rows(tmp_path):
    rows = [row(k, axes={"noise": k}) for k in range(10_000)]
    Journal(tmp_path).append(rows)
    write_results(tmp_path, rows)
    table = load_results(tmp_path)
    assert len(table) == 10_000 and table["noise"].sum() == sum(range(10_000))


def test_no_study_is_one_message(tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match=r"holds no study results: journal\.jsonl is missing"):
            load_results(folder)
    Journal(tmp_path).append([])
    assert len(load_results(tmp_path)) == 0


@pytest.mark.parametrize("module", ["pandas", "pyarrow"])
def test_without_its_extra(study, monkeypatch, module):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"{module} is not installed.*twinct\[study\]"):
        load_results(study)
