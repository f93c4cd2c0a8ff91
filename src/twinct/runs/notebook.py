"""A finished run in a notebook: its volume, the figures of the image, and where its report lies."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from html import escape
from typing import Any

from twinct.recon.volume import Volume
from twinct.report.figure_words import figure_words
from twinct.runs.folder import Folder


def run_in_notebook(name: str, folder: Folder, volume: Volume, figures: Mapping[str, Any]) -> str:
    """Return a run as HTML that needs no other files.

    Args:
        name: name of the run.
        folder: its files.
        volume: the reconstruction.
        figures: content of ``metrics.json``.
    """
    rows: list[str] = []
    for key, value in figures.get("image", {}).items():
        if isinstance(value, int | float) and not isinstance(value, bool):
            words = figure_words(f"image.{key}")
            shown = f"{words.factor * value:.{words.digits}f}"
            rows.append(f"<tr><td>{escape(words.label)}</td><td>{shown}</td></tr>")
    drawn = io.BytesIO()
    volume.show(drawn)
    picture = base64.b64encode(drawn.getvalue()).decode("ascii")
    report = ""
    if folder.report.is_file():
        report = f"<p>Report: {escape(str(folder.report))}</p>"
    return (
        f"<p><b>{escape(name)}</b></p>"
        f'<img alt="sections of the volume" src="data:image/png;base64,{picture}">'
        f"<table>{''.join(rows)}</table>{report}"
    )
