"""The report as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.writing import write_text
from twinct.core.foreign_text import counted
from twinct.evaluation import DEPTHS_MM, IMAGE_FIGURES, MOTION_FIGURES, pose_errors
from twinct.report.algorithm_results import with_results
from twinct.report.data import ReportData
from twinct.report.measured import (
    curve_pictures,
    depth_picture,
    measured_rows,
    nested,
    reasons,
)
from twinct.report.physics import physics_in_words
from twinct.report.pose_words import named_pose_errors
from twinct.report.style import Picture
from twinct.report.template import rendered
from twinct.scenario import AnyCell, GantryCell

PAPER = (
    "Freiling, Schaar, Stille, Kundrat: A Twin Robotic CT System Simulation using MuJoCo and gVXR "
    "for Medical Applications"
)
PAPER_TABLE_1 = {
    "source": {
        "position_mm": {"mean": 0.87, "std": 0.05, "max": 0.98},
        "rotation_deg": {"mean": 0.19, "std": 0.03, "max": 0.23},
    },
    "detector": {
        "position_mm": {"mean": 0.76, "std": 0.07, "max": 0.96},
        "rotation_deg": {"mean": 0.20, "std": 0.05, "max": 0.41},
    },
}
"""Table 1 of the paper: executed against commanded poses, 399 views, trigger at 1 mm."""


LEAD = ("rmse_bone_rel", "ssim_bone", "edge_width_mm")
"""Figures at the top of a report: those near the object."""

Pictures = dict[str, Picture | None]

_STAGES = {
    "specimen": "specimen, and its visibility in the views",
    "plan": "planning: inverse kinematics, clearance",
    "motion": "motion of the arms",
    "xray": "X-ray projections",
    "storing": "storing views and volume",
    "link": "start and end of both simulations",
    "truth": "truth and the region that every view sees",
    "reconstruction": "reconstruction",
    "judge": "judging the image",
    "report": "pictures of this report",
    "other": "everything else",
    "total": "whole run",
}


def write_report(path: Path, report: ReportData, pictures: Pictures | None = None) -> None:
    """Write a report, completely or not at all. Its pictures are drawn here if None."""
    write_text(path, render_report(report, pictures))


def render_report(report: ReportData, pictures: Pictures | None = None) -> str:
    """Return the report as HTML text: images inline, no script, no external resources."""
    scenario, metrics = report.scenario, report.metrics
    speeds = metrics.get("tool_speed_mm_s", {}).values()
    fastest_mm_s = max((speed["max"] for speed in speeds), default=0.0)
    cell, columns = scenario.cell, _columns(report)
    moves = MOTION_FIGURES if scenario.specimen.motion else ()
    beside, shown = (
        _beside(report),
        [f.relative_to(report.reference) for f in (*IMAGE_FIGURES, *moves)],
    )
    return rendered(
        "report.html",
        fastest_mm_s=fastest_mm_s,
        step_mm=fastest_mm_s * (cell.timestep_ms if cell.kind == "arms" else 0.0) / 1000,
        name=scenario.name,
        description=scenario.description,
        setting=_setting(report),
        metrics=metrics,
        paper=PAPER,
        paper_table=PAPER_TABLE_1,
        pictures=(draw_pictures(report) if pictures is None else pictures)
        | {
            "depth": depth_picture(columns, DEPTHS_MM),
        },
        reference=report.reference,
        image_columns=[*columns, *beside],
        image_rows=[
            (one, [nested(figures, one.key) for figures in (columns | beside).values()])
            for one in shown
        ],
        lead=[(one, nested(metrics["image"], one.key)) for one in shown if one.key in LEAD],
        reasons=reasons(columns),
        measured_columns=[*columns],
        measured_rows=measured_rows(columns, report.reference),
        curves=curve_pictures(columns, report.reference),
        implants=_implants(metrics),
        others=[(f"slices {other.name}", other) for other in report.others],
        predictions=[(words, picture.data_uri) for words, picture in report.predictions],
        stages=_stages(metrics["seconds"]),
        nearest=" and ".join(report.nearest),
        arms=scenario.cell.kind == "arms",
        trigger=scenario.motion.trigger,
        pose_errors=named_pose_errors(report.metrics),
        tolerance_mm=scenario.motion.tolerance_mm,
        scenario_yaml=report.scenario_yaml,
    )


def _implants(metrics: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the known implants that were located, each with the name of its reconstruction."""
    of_all = {"main reconstruction": metrics} | dict(metrics.get("reconstructions", {}))
    return [(name, one) for name, results in of_all.items() for one in results.get("implants", ())]


def stage_title(name: str) -> str:
    """Return the title of a stage in a table of seconds."""
    return _STAGES.get(name, name.replace("_", " "))


def _columns(report: ReportData) -> dict[str, Any]:
    """Return image figures by title: the geometries of the run, then the other reconstructions."""
    first = report.scenario.reconstruction.geometries[0]
    own = report.metrics.get("image_by_geometry") or {first: report.metrics["image"]}
    named = {f"{name} geometry": figures for name, figures in own.items()}
    return named | {other.name: other.figures for other in report.others}


def _beside(report: ReportData) -> dict[str, Any]:
    """Return further columns: the cost of the poses' errors, and the figures of an empty volume."""
    results = {
        "believed − executed": report.metrics.get("believed_minus_executed"),
        "empty volume": report.metrics["image"].get("zero"),
    }
    return {title: figures for title, figures in results.items() if figures}


def draw_pictures(report: ReportData) -> Pictures:
    """Draw the pictures of a report, which takes longest; they do not depend on its metrics."""
    from twinct.report import figures
    from twinct.report.convergence import convergence

    scenario = report.scenario
    commanded, executed = (
        np.array([pose.position for pose in poses.source])
        for poses in (report.commanded, report.executed)
    )
    # A trajectory from a file has no isocentre: the world's origin stands in.
    isocentre = np.array(getattr(scenario.trajectory, "isocentre_mm", (0.0, 0.0, 0.0)))
    mu = report.mu_reference
    if mu is None and report.slices:
        mu = max(float(section.truth.max()) for section in report.slices.values())
    courses = dict(report.metrics.get("residuals", {}))
    courses |= {other.name: other.residuals for other in report.others}
    compared = [*report.slices.values()] if report.others else []
    compared += [section for other in report.others for section in other.slices.values()]
    return {
        "room": Picture(report.room_png, "image/png") if report.room_png else None,
        "path": figures.source_path(commanded, executed, isocentre),
        "errors": figures.pose_errors_over_views(
            pose_errors(report.commanded, report.executed),
            np.asarray(report.clearance_mm, dtype=np.float64),
            scenario.motion.tolerance_mm,
            scenario.motion.clearance_mm,
        )
        if scenario.cell.kind == "arms"
        else None,
        "convergence": convergence(courses)
        if any(len(course) > 1 for course in courses.values())
        else None,
        "slices": figures.cross_section_grid(report.slices, mu or 1.0, compared)
        if report.slices
        else None,
        **{
            f"slices {other.name}": figures.cross_section_grid(other.slices, mu or 1.0, compared)
            for other in report.others
        },
        "projections": figures.projection_strip(report.projections, report.panel)
        if report.projections
        else None,
    }


def _machine(cell: AnyCell) -> dict[str, str]:
    """Return the machine that carries source and panel."""
    if isinstance(cell, GantryCell):
        return {"Gantry": "source and panel exactly at their commanded poses"}
    return {"Arms": f"{cell.source_arm.label} (source), {cell.detector_arm.label} (detector)"}


def _setting(report: ReportData) -> dict[str, str]:
    """Return the experiment in a few lines."""
    scenario = report.scenario
    grid = scenario.reconstruction.volume_grid
    voxel = " × ".join(f"{edge:g}" for edge in dict.fromkeys(grid.voxel.tolist()))
    apart = {**report.metrics, "warnings": ()}  # they stand above the figures
    return {
        "Specimen": ", ".join(f"{p.label} ({p.made_of})" for p in scenario.specimen.parts),
        **({"Motion": report.motion} if report.motion else {}),
        "Trajectory": f"{scenario.trajectory.kind}, {counted(report.metrics['views'], 'view')}",
        **_machine(scenario.cell),
        **physics_in_words(scenario, *report.commanded[0], report.mas),
        "Reconstruction": with_results(scenario.reconstruction.in_words, apart),
        "Grid": f"{' × '.join(map(str, grid.shape_xyz))} voxels of {voxel} mm",
    }


def _stages(seconds: dict[str, float]) -> list[dict[str, Any]]:
    """Return name, seconds and share of the whole run, in the order of the run."""
    total = seconds.get("total") or 0.0
    order = [name for name in seconds if name != "total"] + ["total"] * ("total" in seconds)
    return [
        {
            "name": stage_title(name),
            "seconds": seconds[name],
            "share": min((seconds[name] or 0.0) / total, 1.0) if total else 0.0,
        }
        for name in order
    ]
