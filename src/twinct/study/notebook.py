"""A study in a notebook: its first figure, as a picture and a table, and where its page lies."""

from __future__ import annotations

import base64
import io
from html import escape
from pathlib import Path

from twinct.core.errors import InputError
from twinct.study.table import StudyTable, figures_of


def study_in_notebook(name: str, table: StudyTable, page: Path) -> str:
    """Return a study as HTML that needs no other files.

    Args:
        name: name of the study.
        table: its results.
        page: its page, if it exists.
    """
    shown = [f"<p><b>{escape(name)}</b>: {len(table)} trials</p>"]
    if figures := figures_of(table)[:1]:
        drawn = io.BytesIO()
        try:
            table.plot(figures[0], path=drawn)
        except InputError:  # no axis varies
            pass
        else:
            picture = base64.b64encode(drawn.getvalue()).decode("ascii")
            alt = escape(f"{figures[0]} over the first axis")
            shown.append(f'<img alt="{alt}" src="data:image/png;base64,{picture}">')
        shown.append(table.summary(figures[0]).to_html(index=False, border=0))
    if page.is_file():
        shown.append(f"<p>Page: {escape(str(page))}</p>")
    return "".join(shown)
