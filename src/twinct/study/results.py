"""Table of a study's results, made from its journal and stored as a parquet file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.packed import require_unpacked
from twinct.core.files.writing import complete, storage_errors
from twinct.core.foreign_text import quoted
from twinct.study.journal import Journal, Row

if TYPE_CHECKING:
    from twinct.study.table import StudyTable

NAME = "results.parquet"

_FIRST = ("trial",)
_LAST = ("reference_material", "message", "kind", "scan", "report", "key")
_BETWEEN = ("seed", "status")
OWN_COLUMNS = frozenset(_FIRST + _BETWEEN + _LAST)
"""Names that no axis may have; names of figures and "seconds.*" are reserved, too."""

_JOURNAL_BYTES = b"twinct.bytes_of_journal"
"""Metadata key of the journal's size; it dates the results, as copies change file times.

Version 1.0 wrote another key, and other names of figures: its table is made anew.
"""


def results_table(rows: Iterable[Row]) -> StudyTable:
    """Return a table with a line for each trial, sorted by number.

    Columns are the trial's number, its value on each axis, seed, status, figures by dotted name,
    ``seconds.STAGE``, reference material, message, kind, scan, report and key. Types do not depend
    on missing values: whole numbers are Int64, other numbers float64 (NaN: missing), truth values
    boolean, texts string. An axis with values of several kinds is text, with values other than text
    as JSON.

    Raises:
        InputError: two columns would have the same name.
        MissingExtraError: the extra ``study`` is not installed.
    """
    require("study")
    import pandas as pd

    from twinct.study.table import StudyTable

    rows = sorted(rows, key=lambda row: (row.trial, row.key))
    axes, figures, stages = (
        list(dict.fromkeys(name for row in rows for name in getattr(row, of)))
        for of in ("axes", "figures", "seconds")
    )
    columns: list[tuple[str, Any]] = [("trial", pd.array([r.trial for r in rows], dtype="int64"))]
    columns += [(name, _typed([row.axes.get(name) for row in rows])) for name in axes]
    columns += [("seed", pd.array([row.seed for row in rows], dtype="Int64"))]
    columns += [("status", _texts([row.status for row in rows]))]
    columns += [(name, _numbers([row.figures.get(name) for row in rows])) for name in figures]
    columns += [
        (f"seconds.{name}", _numbers([row.seconds.get(name) for row in rows])) for name in stages
    ]
    columns += [(name, _texts([getattr(row, name) for row in rows])) for name in _LAST]
    names = [name for name, _ in columns]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"axis {quoted(twice[0])}: another column of the results has this name")
    return StudyTable(dict(columns))


def _typed(values: Sequence[Any]) -> Any:
    """Return a column of a single type, missing values included."""
    import pandas as pd

    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return pd.array(values, dtype="boolean")
    if kinds == {int}:
        return pd.array(values, dtype="Int64")
    if kinds and kinds <= {int, float}:
        return _numbers(values)
    return _texts(
        [
            v if v is None or isinstance(v, str) else json.dumps(v, ensure_ascii=False)
            for v in values
        ]
    )


def _numbers(values: Sequence[float | None]) -> Any:
    import numpy as np

    return np.array(values, dtype=np.float64)


def _texts(values: Sequence[str | None]) -> Any:
    import pandas as pd

    return pd.array(values, dtype="string")


def write_results(folder: Path, rows: Iterable[Row]) -> None:
    """Write ``results.parquet`` into a study's folder, completely or not at all.

    Args:
        folder: folder of the study.
        rows: all rows of its journal, from ``Journal.rows``.

    Raises:
        InputError: two columns would have the same name.
        MissingExtraError: the extra ``study`` is not installed.
        StorageError: the file cannot be written.
    """
    require("study")
    import pyarrow as pa
    import pyarrow.parquet as pq

    held = Journal(folder).whole_bytes()
    table = pa.Table.from_pandas(results_table(rows), preserve_index=False)
    data = {**(table.schema.metadata or {}), _JOURNAL_BYTES: str(held).encode()}
    path = folder / NAME
    # By a stream, as pyarrow takes no names that are not UTF-8.
    with storage_errors(path), complete(path) as draft, draft.open("wb") as stream:
        pq.write_table(table.replace_schema_metadata(data), stream)


def _require_table(path: Path, whole: Any) -> None:
    """Check that a table is no larger in memory than its file allows: runs of one value are short.

    Raises:
        InputError: it is larger.
    """
    groups = [whole.row_group(k) for k in range(whole.num_row_groups)]
    columns = max(whole.num_columns, 1)
    values = 8 * columns * max(whole.num_rows, sum(group.num_rows for group in groups))
    stated = max(values, sum(group.total_byte_size for group in groups))
    require_unpacked(path.stat().st_size, stated, f"{path}: the table", copies=2)


@kinds_checked
def load_results(folder: str | Path) -> StudyTable:
    """Load the results of a finished or running study as a pandas table; see ``results_table``.

    ``summary()`` of the table returns means, intervals and paired differences over the seeds, and
    ``plot("image.rmse_rel", path="picture.pdf")`` draws a figure over an axis.

    The table is read from ``results.parquet``, or made from the journal if the journal is newer.

    Raises:
        InputError: the folder holds no study, or its journal is broken.
        MissingExtraError: the extra ``study`` is not installed.
    """
    require("study")
    import pyarrow as pa
    import pyarrow.parquet as pq

    from twinct.study.table import StudyTable

    journal, path = Journal(Path(folder)), Path(folder) / NAME
    if not journal.path.is_file():
        raise InputError(
            f"{folder} holds no study results: {journal.path.name} is missing; "
            "it appears when the first trial has ended"
        )
    try:
        with path.open("rb") as stream:
            whole = pq.read_metadata(stream)
            stated = (whole.metadata or {}).get(_JOURNAL_BYTES)
        if stated == str(journal.whole_bytes()).encode():
            _require_table(path, whole)
            with path.open("rb") as stream:
                return StudyTable(pq.read_table(stream).to_pandas())
    except (OSError, pa.ArrowException):
        pass  # absent or damaged: the journal is complete
    return results_table(journal.rows())
