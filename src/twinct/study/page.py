"""Page of a study, made from its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twinct.evaluation.figure import REFERENCE
from twinct.report.figure_words import axis_words, with_companions
from twinct.report.repetitions import StudyTrial
from twinct.report.study_page import StudyAxis, StudyData, best_trials, write_study
from twinct.study.design import Design
from twinct.study.folder import StudyFolder
from twinct.study.journal import Row
from twinct.study.rows import sections_of
from twinct.study.sections import read_sections
from twinct.study.settings import Axis


def write_page(
    folder: StudyFolder, design: Design, rows: Sequence[Row], total: int, wall_seconds: float
) -> None:
    """Write ``study.html`` with all trials that have ended.

    Raises:
        StorageError: the page cannot be written.
    """
    study = design.study
    ranked, better = study.ranked_by
    figures = with_companions((ranked, *(name for name in study.figures if name != ranked)))
    materials = {row.reference_material or REFERENCE for row in rows if row.status == "done"}
    data = StudyData(
        title=study.name,
        description=study.description,
        best=better,
        axes=_axes(design),
        figures=figures,
        trials=[
            StudyTrial(
                trial=row.trial,
                axes=row.axes,
                seed=row.seed,
                done=row.status == "done",
                figures=row.figures,
                seconds=row.seconds,
                message=row.message,
                kind=row.kind,
                report=row.report,
            )
            for row in rows
        ],
        yaml=design.text,
        reference=materials.pop() if len(materials) == 1 else REFERENCE,
        planned=total if len(rows) < total else None,
        wall_seconds=wall_seconds,
    )
    stored = {row.trial: path for row in rows if (path := sections_of(folder, row))}
    shown = {n: read_sections(stored[n]) for n in best_trials(data) if n in stored}
    mu_reference = next((mu for _, mu in shown.values()), None)
    sections = {number: arrays for number, (arrays, _) in shown.items()}
    write_study(folder.page, replace(data, sections=sections, mu_reference=mu_reference))


def _axes(design: Design) -> list[StudyAxis]:
    """Return the axes in the order of their labels; without a label, its keys name an axis."""
    study = design.study
    parts = [part for axis in study.axes for part in axis.paired or (axis,)]
    dimensions = study.search.keys if study.search else ()
    log = {part.name for part in parts if _is_log(part)}
    log |= {one.name for one in dimensions if one.scale == "log"}
    keys = {one.name: one.keys for one in (*parts, *dimensions)}
    axes = [
        StudyAxis(label, log=label in log, keys=", ".join(keys[label])) for label in design.labels
    ]
    words = axis_words([keys[label] for label in design.labels])
    return [
        replace(one, name=name, unit=unit) if one.label == one.keys else one
        for one, (name, unit) in zip(axes, words, strict=True)
    ]


def _is_log(axis: Axis) -> bool:
    return bool(axis.range and axis.range.scale == "log") or bool(
        axis.draw and axis.draw.kind == "log_uniform"
    )
