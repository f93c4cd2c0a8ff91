"""The results of a study as one table: made from its journal, kept as a parquet file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinct.errors import InputError
from twinct.extras import require
from twinct.files.writing import complete, storage_errors
from twinct.study.journal import Journal, Row

if TYPE_CHECKING:
    import pandas as pd

NAME = "results.parquet"

_FIRST, _LAST = ("trial",), ("message", "kind", "scan", "report", "key")
_BETWEEN = ("seed", "status")
OWN_COLUMNS = frozenset(_FIRST + _BETWEEN + _LAST)
"""Names that no axis may have; nor may one be that of a figure, or begin with "seconds."."""

_JOURNAL_BYTES = b"twinct.journal_bytes"
"""How much of the journal a file of results holds: clocks do not tell, files are copied."""


def results_table(rows: Iterable[Row]) -> pd.DataFrame:
    """A line for each trial, by its number.

    Columns are the trial's number, its value on each axis, seed, status, figures by dotted name,
    ``seconds.STAGE``, message, kind, scan, report and key. Types do not depend on what is missing:
    whole numbers are Int64, other numbers float64 (NaN: none), truth values boolean, texts string.
    An axis with values of several kinds is text, as JSON where a value is none.

    Raises:
        InputError: two columns would have one name.
        MissingExtraError: the extra ``study`` is not installed.
    """
    require("study")
    import pandas as pd

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
        raise InputError(f"axis {twice[0]!r}: another column of the results has this name")
    return pd.DataFrame(dict(columns))


def _typed(values: Sequence[Any]) -> Any:
    """A column of one type, missing values included."""
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
    """Write ``results.parquet`` into a study's folder, complete or not at all.

    Args:
        folder: of the study.
        rows: all that its journal holds, as ``Journal.rows`` gives them.

    Raises:
        InputError: two columns would have one name.
        MissingExtraError: the extra ``study`` is not installed.
        StorageError: it cannot be written.
    """
    require("study")
    import pyarrow as pa
    import pyarrow.parquet as pq

    held = Journal(folder).whole_bytes()
    table = pa.Table.from_pandas(results_table(rows), preserve_index=False)
    told = {**(table.schema.metadata or {}), _JOURNAL_BYTES: str(held).encode()}
    path = folder / NAME
    with storage_errors(path), complete(path) as draft:
        pq.write_table(table.replace_schema_metadata(told), draft)


def load_results(folder: str | Path) -> pd.DataFrame:
    """The results of a study, as far as it has come, as a pandas table; see ``results_table``.

    They are read from ``results.parquet``, or made from the journal where that has more.

    Raises:
        InputError: it is no folder of a study, or its journal is broken.
        MissingExtraError: the extra ``study`` is not installed.
    """
    require("study")
    import pyarrow as pa
    import pyarrow.parquet as pq

    journal, path = Journal(Path(folder)), Path(folder) / NAME
    if not journal.path.is_file():
        raise InputError(
            f"{folder}: no results of a study: there is no {journal.path.name} in it; "
            "it appears when the first trial has ended"
        )
    try:
        told = (pq.read_schema(path).metadata or {}).get(_JOURNAL_BYTES)
        if told == str(journal.whole_bytes()).encode():
            return pq.read_table(path).to_pandas()
    except (OSError, pa.ArrowException):
        pass  # none yet, or damaged: the journal has it all
    return results_table(journal.rows())
