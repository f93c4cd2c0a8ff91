"""Views from a CSV file, each exactly as stated."""

from __future__ import annotations

import csv
import io
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from twinct.core.errors import TrajectoryError
from twinct.core.files.boundary import read_text
from twinct.core.files.writing import complete
from twinct.core.foreign_text import number as number_of
from twinct.core.foreign_text import quoted, shortened
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.family import Family, TrajectorySettings
from twinct.trajectory.orbit import panel_axes

LARGEST_BYTES = 64 * 2**20
MOST_VIEWS = 100_000
"""Largest number of views, as for all other trajectories."""

SHORTEST_MM, WIDEST = 10.0, 10.0
"""Least distance of source and panel, and largest ratio of the panel's edge to that distance."""

_COLUMNS = [f"{name}_{axis}" for name in ("source", "detector", "u", "v") for axis in "xyz"]
_MAS = "mas"
_FORMS = (6, 7, 12, 13)
"""Allowed numbers of values per line; in lines of 7 and 13 the last value is mAs."""


class FileTrajectory(TrajectorySettings):
    """Views from a CSV file: each row has S and D in mm, or S, D, u and v; mAs may follow."""

    kind: Literal["file"]
    path: Path = Field(description="CSV file.")


def write_views(path: Path, geometry: ScanGeometry, mas: Floats | None = None) -> None:
    """Write a file of views that ``kind: file`` reads back to the same numbers.

    Args:
        path: path of the file.
        geometry: the views.
        mas: tube load of each view, (views,), mAs; None: the file does not state it.
    """
    rows = rows_of_views(geometry)
    write_rows(path, rows if mas is None else np.column_stack([rows, mas]))


def rows_of_views(views: ScanGeometry | ArrayLike | tuple[ArrayLike, ...]) -> Floats:
    """Return views as the rows of a file of views.

    Args:
        views: a geometry, whose panel does not count; the rows themselves, (views, 6, 7, 12 or 13);
            or their columns side by side: source and detector, (views, 3), mm, perhaps u and v,
            (views, 3), perhaps the tube load, (views,), mAs.

    Raises:
        ValueError: the arrays form no views; a view is invalid.
    """
    if isinstance(views, ScanGeometry):
        return np.hstack([views.source, views.detector, views.u, views.v])
    rows = np.column_stack(views) if isinstance(views, tuple) else np.asarray(views)
    rows = rows.astype(np.float64)
    if rows.ndim != 2 or rows.shape[1] not in _FORMS or not 1 <= len(rows) <= MOST_VIEWS:
        raise ValueError(
            f"arrays of shape {rows.shape} form no views: a view has 6 numbers (S, D) or 12 (S, D, "
            f"u, v) in mm, and optionally its mAs at the end; at most {MOST_VIEWS} views"
        )
    if rows.shape[1] in (7, 13) and not (rows[:, -1] > 0).all():
        raise ValueError(f"mAs of view {int((~(rows[:, -1] > 0)).argmax())} is not above 0")
    try:
        _geometry(rows, Panel(1, 1, 1.0, 1.0))
    except TrajectoryError as error:
        raise ValueError(str(error)) from None
    return rows


def write_rows(path: Path, rows: Floats) -> None:
    """Write the rows of a file of views, which are read back to the same numbers.

    Args:
        path: path of the file.
        rows: (views, 6, 7, 12 or 13), as ``rows_of_views`` returns them.
    """
    columns = _COLUMNS[: rows.shape[1] // 6 * 6] + [_MAS] * (rows.shape[1] % 6)
    with complete(path) as draft, draft.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows([[repr(float(x)) for x in row] for row in rows])


def _table(path: Path) -> tuple[Floats, list[int]]:
    """Return the rows of the file and their line numbers.

    A row has 6 numbers (S, D) or 12 (S, D, u, v), mm, and one more with mAs. A line of names may
    come first.
    """
    lines = _lines(path)
    problems: list[str] = []
    rows: list[list[float]] = []
    numbers: list[int] = []
    for position, (number, row) in enumerate(lines):
        try:
            rows.append([number_of(cell) for cell in row])
        except ValueError:
            first = position == 0
            problems += [f"{path}:{number}: {what}" for what in _wrong_names(row, first)]
            continue
        numbers.append(number)
        problems += [f"{path}:{number}: {what}" for what in _wrong_numbers(row, rows[-1])]
    if len(rows) > MOST_VIEWS:
        problems.append(f"{path}: more than {MOST_VIEWS} views, the limit of a scan")
    if not problems and not rows:
        problems.append(f"{path}: contains no view")
    if not problems and len(forms := sorted({len(row) for row in rows})) > 1:
        problems.append(
            f"{path}: some lines have {forms[0]} numbers, others {forms[1]}; use one form"
        )
    if problems:
        raise TrajectoryError(problems)
    return np.array(rows), numbers


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Return the cells of each line that is neither empty nor a comment, and the line's number."""
    try:
        text = read_text(path, f"{path}: the table of views", LARGEST_BYTES, TrajectoryError)
        read = enumerate(csv.reader(io.StringIO(text, newline="")), start=1)
        lines = list(islice(((n, row) for n, row in read if row), MOST_VIEWS + 2))
    except csv.Error as error:
        raise TrajectoryError(f"{path}: cannot read the views: {error}") from None
    return [(n, row) for n, row in lines if not row[0].lstrip().startswith("#")]


def _wrong_names(row: list[str], first: bool) -> list[str]:
    """Return what is wrong with a line of texts: only the first line may hold names."""
    if not first or any(map(_is_number, row)):
        return [f"{_in_words(row)} holds something that is not a number"]
    if len(row) in (7, 13) and (name := row[-1].strip()) != _MAS:
        return [f"the last of {len(row)} columns must be {_MAS}, not {quoted(name, 50)}"]
    return []


def _wrong_numbers(row: list[str], values: list[float]) -> list[str]:
    """Return what is wrong with a line of numbers."""
    if len(row) not in _FORMS:
        return [
            "a view has 6 numbers (S, D) or 12 (S, D, u, v) in mm, and optionally its mAs at the "
            f"end; this line has {len(row)}"
        ]
    if not np.isfinite(values).all():
        return [f"{_in_words(row)} holds a number that is not finite"]
    if len(row) in (7, 13) and values[-1] <= 0:
        return [f"mAs is {values[-1]:g}, but must be above 0"]
    return []


def _in_words(row: list[str]) -> str:
    return repr(shortened(",".join(row), 200))


def _is_number(cell: str) -> bool:
    try:
        number_of(cell)
    except ValueError:
        return False
    return True


def _views(section: FileTrajectory, panel: Panel) -> ScanGeometry:
    """Return the geometry in the file; the panel is upright if the file does not state u and v."""
    table, lines = _table(section.path)
    _require_mm(table, panel, section.path)
    try:
        return _geometry(table, panel)
    except (ValueError, TrajectoryError):
        problems: list[str] = []
        for row, line in zip(table, lines, strict=True):
            try:
                _geometry(row[None], panel)
            except (ValueError, TrajectoryError) as error:
                what = str(error).removeprefix("view 0: ").replace(" of view 0", "")
                problems.append(f"{section.path}:{line}: {what}")
        raise TrajectoryError(problems) from None


def _require_mm(table: Floats, panel: Panel, path: Path) -> None:
    """Refuse views that seem to be in metres.

    Raises:
        TrajectoryError: source and panel are nearer to each other than any scanner has them.
    """
    apart = float(np.median(np.linalg.norm(table[:, 0:3] - table[:, 3:6], axis=1)))
    if 0 < apart < max(SHORTEST_MM, max(panel.size_mm) / WIDEST):
        raise TrajectoryError(
            f"{path}: source and panel are only {apart:.3g} mm apart, the panel is "
            f"{panel.size_mm[0]:g} x {panel.size_mm[1]:g} mm: are the positions in metres? They "
            "must be in mm: multiply them by 1000"
        )


def _geometry(table: Floats, panel: Panel) -> ScanGeometry:
    source, detector = table[:, 0:3], table[:, 3:6]
    if _has_axes(table):
        return ScanGeometry(source, detector, table[:, 6:9], table[:, 9:12], panel)
    beam = source - detector
    length = np.linalg.norm(beam, axis=1)
    if (length == 0).any():
        raise ValueError("source and panel coincide")
    u, v = panel_axes(beam / length[:, None])
    return ScanGeometry(source, detector, u, v, panel)


def _has_axes(table: Floats) -> bool:
    return table.shape[1] >= 12


def _mas(section: FileTrajectory) -> Floats | None:
    table, _ = _table(section.path)
    return table[:, -1] if table.shape[1] in (7, 13) else None


FILE = Family(FileTrajectory, _views, lambda section: not _has_axes(_table(section.path)[0]), _mas)
