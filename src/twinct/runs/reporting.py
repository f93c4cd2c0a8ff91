"""The figures and the report of a run, written into its folder."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twinct.evaluate import ImageFigures, pose_errors
from twinct.files.writing import write_json
from twinct.report import ReportData, build_metrics, cross_sections, draw_pictures, write_report
from twinct.runs.folder import Folder, as_yaml
from twinct.runs.judgement import Truth
from twinct.runs.seconds import Seconds, Timing
from twinct.scan import Scan, Workshop
from twinct.scenario import stage_digests
from twinct.volume import Volume

_SHOWN_VIEWS = 4
"""Projections shown in the report."""


@dataclass(frozen=True, eq=False)
class Results:
    """What a run found out, beside its scan.

    Attributes:
        volume: the reconstruction that is kept, 1/mm.
        truth: what it is judged against.
        figures: of each geometry that was reconstructed from.
        residuals: of each iteration, by geometry.
    """

    volume: Volume
    truth: Truth
    figures: Mapping[str, ImageFigures]
    residuals: Mapping[str, list[float]]


def write_results(
    folder: Folder, workshop: Workshop, scan: Scan, results: Results, timing: Seconds | Timing
) -> None:
    """Write report.html and metrics.json, each complete or not at all.

    Args:
        folder: where.
        workshop: the scenario's parts.
        scan: what was taken.
        results: what became of it.
        timing: of this run, still counting, or of the run that is reported again.
    """
    scenario = workshop.scenario
    if isinstance(timing, Seconds):
        with timing.stage("report"):
            data = _report_data(scan, workshop, results)
            pictures = draw_pictures(data)
        timing = timing.finished()
    else:
        data = _report_data(scan, workshop, results)
        pictures = draw_pictures(data)
    digests = stage_digests(scenario)
    metrics = build_metrics(
        views=len(workshop.targets),
        reached=len(scan),
        pose_errors=pose_errors(scan.commanded, scan.executed),
        clearance_mm=scan.clearance_mm,
        image=results.figures,
        seconds=timing.stages,
        simulated_seconds=float(scan.simulated_s[-1]),
        real_time_factor=timing.real_time_factor,
        scenario_digest=digests["images"],
        reconstruction_digest=digests["volume"],
        residuals=results.residuals,
        reference_material=workshop.specimen.reference_part.material.name,
    )
    write_report(folder.report, replace(data, metrics=metrics), pictures)
    write_json(folder.metrics, metrics)


def _report_data(scan: Scan, workshop: Workshop, results: Results) -> ReportData:
    """All that a report shows but the figures."""
    scenario, truth = workshop.scenario, results.truth
    shown = np.unique(np.linspace(0, len(scan) - 1, _SHOWN_VIEWS).round().astype(int))
    return ReportData(
        scenario=scenario,
        scenario_yaml=as_yaml(scenario),
        metrics={},
        commanded=scan.commanded,
        executed=scan.executed,
        panel=scenario.detector.panel,
        clearance_mm=scan.clearance_mm,
        projections=[(int(view), scan.transmission[view]) for view in shown],
        slices=cross_sections(
            results.volume.array,
            truth.volume,
            truth.region,
            scenario.reconstruction.grid.volume_grid,
        ),
        mu_reference=truth.mu_reference,
        reference=workshop.specimen.reference_part.material.name,
        room_png=_room(workshop),
        nearest=workshop.plan.nearest[int(workshop.plan.clearance_mm.argmin())],
    )


def _room(workshop: Workshop) -> bytes:
    """Picture of the room with the arms in the middle of the path."""
    from twinct.cell import render_cell

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.png"
        render_cell(workshop.room, path, workshop.plan.joints[len(workshop.targets) // 2])
        return path.read_bytes()
