"""``twinct compare``: runs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct import runs
from twinct.cli.arguments import Json
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal, say
from twinct.core.files.writing import check_page, storage_errors
from twinct.core.foreign_text import counted
from twinct.report.pose_words import named_pose_errors
from twinct.runs.folder import refuse_result


def compare(
    folders: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DIR")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="HTML")] = Path("compare.html"),
    as_json: Json = False,
) -> None:
    """Compare finished runs on one page: slices, figures, pose errors, times, and their scenarios.

    Slices show the same places in the same windows; differences refer to the first run. Measured
    scans are compared with each other, by the figures that need no truth.

    Args:
        folders: Folders of twinct run --out, or DIR/reconstructions/NAME for results of
            twinct reconstruct; two or more. A measured scan's folder means all its volumes.
        out: File to write.
    """
    check_page(out)
    refuse_result(out)
    with answering(as_json) as answer:
        with on_terminal() as audience:
            comparison = runs.compare(folders, audience)
        for note in comparison.notes:
            say(note, warning=True)
        with storage_errors(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            comparison.write(out)
        differ = "differs" if len(comparison.keys) == 1 else "differ"
        say(f"wrote {out}: {counted(len(comparison.keys), 'scenario key')} {differ}")
        answer |= {"page": str(out), "notes": comparison.notes, "keys": comparison.keys}
        answer["runs"] = [
            {"path": one.path, "label": one.label, "image": one.image, "seconds": one.seconds}
            | ({"pose_errors": named_pose_errors(one.metrics)} if comparison.has_truth else {})
            for one in comparison.compared
        ]
