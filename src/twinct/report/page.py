"""The report as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.files.writing import write_text
from twinct.core.foreign_text import counted
from twinct.evaluation import DEPTHS_MM, IMAGE_FIGURES, MOTION_FIGURES, pose_errors
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
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
from twinct.report.without_truth import judged_rows, residuals_by_view, section_row, top_of
from twinct.scenario import AnyCell, GantryCell, Scenario
from twinct.version import __version__

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


LEAD = ("rmse_near_rel", "ssim_near", "edge_width_mm")
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
    settings, metrics, columns = report.scenario, report.metrics, _columns(report)
    moves = MOTION_FIGURES if settings.specimen and settings.specimen.motion else ()
    beside, shown = (
        _beside(report),
        [f.relative_to(report.reference) for f in (*IMAGE_FIGURES, *moves)],
    )
    without_truth = [] if "image" in metrics else report.others
    return rendered(
        "report.html",
        kicker="Twin robotic CT simulation" if report.commanded else "Measured CT scan",
        name=settings.name,
        description=settings.description,
        setting=_setting(report),
        metrics=metrics,
        paper=PAPER,
        paper_table=PAPER_TABLE_1,
        pictures=(draw_pictures(report) if pictures is None else pictures)
        | {"depth": depth_picture(columns, DEPTHS_MM) if "image" in metrics else None},
        reference=report.reference,
        judged=without_truth,
        judged_rows=judged_rows(without_truth),
        image_columns=[*columns, *beside],
        image_rows=[
            (one, [nested(figures, one.key) for figures in (columns | beside).values()])
            for one in shown
        ]
        if "image" in metrics
        else [],
        lead=[
            (one, nested(metrics["image"], one.key))
            for one in shown
            if one.key in LEAD and "image" in metrics
        ],
        reasons=reasons(columns) if "image" in metrics else [],
        measured_columns=[*columns],
        measured_rows=measured_rows(columns, report.reference),
        curves=curve_pictures(columns, report.reference),
        implants=_implants(metrics),
        others=[(f"slices {other.name}", other) for other in report.others],
        predictions=[(words, picture.data_uri) for words, picture in report.predictions],
        stages=_stages(metrics.get("seconds", {})),
        nearest=" and ".join(report.nearest),
        pose_errors=named_pose_errors(metrics) if report.commanded else {},
        scenario_yaml=report.scenario_yaml,
        version=metrics.get("twinct_version", __version__),
        **_of_machine(report),
    )


def _of_machine(report: ReportData) -> dict[str, Any]:
    """Return what the page says of arms; nothing of the machine of an imported scan is known."""
    scenario = report.scenario
    if not isinstance(scenario, Scenario):
        return {"arms": False, "fastest_mm_s": 0.0, "step_mm": 0.0, "trigger": ""} | {
            "tolerance_mm": 0.0
        }
    cell, speeds = scenario.cell, report.metrics.get("tool_speed_mm_s", {}).values()
    fastest_mm_s = max((speed["max"] for speed in speeds), default=0.0)
    return {
        "arms": cell.kind == "arms",
        "fastest_mm_s": fastest_mm_s,
        "step_mm": fastest_mm_s * (cell.timestep_ms if cell.kind == "arms" else 0.0) / 1000,
        "trigger": scenario.motion.trigger,
        "tolerance_mm": scenario.motion.tolerance_mm,
    }


def _implants(metrics: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the known implants that were located, each with the name of its reconstruction."""
    of_all = {"main reconstruction": metrics} | dict(metrics.get("reconstructions", {}))
    return [(name, one) for name, results in of_all.items() for one in results.get("implants", ())]


def stage_title(name: str) -> str:
    """Return the title of a stage in a table of seconds."""
    return _STAGES.get(name, name.replace("_", " "))


def _columns(report: ReportData) -> dict[str, Any]:
    """Return image figures by title: the geometries of the run, then the other reconstructions."""
    first, image = report.scenario.reconstruction.geometries[0], report.metrics.get("image")
    own = report.metrics.get("image_by_geometry") or ({first: image} if image else {})
    named = {f"{name} geometry": figures for name, figures in own.items()}
    return named | {other.name: other.figures for other in report.others}


def _beside(report: ReportData) -> dict[str, Any]:
    """Return further columns: the cost of the poses' errors, and the figures of an empty volume."""
    results = {
        "believed − executed": report.metrics.get("believed_minus_executed"),
        "empty volume": report.metrics.get("image", {}).get("zero"),
    }
    return {title: figures for title, figures in results.items() if figures}


def draw_pictures(report: ReportData) -> Pictures:
    """Draw the pictures of a report, which takes longest; they do not depend on its metrics."""
    from twinct.report import figures
    from twinct.report.convergence import convergence

    mu = report.mu_reference
    if mu is None and report.slices:
        truths = [one.truth for one in report.slices.values() if one.truth is not None]
        mu = max(float(truth.max()) for truth in truths)
    courses = dict(report.metrics.get("residuals", {}))
    courses |= {other.name: other.residuals for other in report.others}
    compared = [*report.slices.values()] if report.others else []
    compared += [section for other in report.others for section in other.slices.values()]
    top = top_of(compared)
    return {
        "room": Picture(report.room_png, "image/png") if report.room_png else None,
        **_pictures_of_poses(report),
        "convergence": convergence(courses)
        if any(len(course) > 1 for course in courses.values())
        else None,
        "slices": figures.cross_section_grid(report.slices, mu or 1.0, compared)
        if report.slices
        else None,
        **{
            f"slices {other.name}": figures.cross_section_grid(other.slices, mu or 1.0, compared)
            if "residual_by_view" not in other.figures
            else section_row(other.slices, top)
            for other in report.others
        },
        "by_view": residuals_by_view(judged)
        if (judged := [one for one in report.others if "residual_by_view" in one.figures])
        else None,
        "projections": figures.projection_strip(report.projections, report.panel)
        if report.projections
        else None,
    }


def _pictures_of_poses(report: ReportData) -> Pictures:
    """Draw the path of the source, and how far source and panel were from it."""
    from twinct.report import figures

    scenario, commanded, executed = report.scenario, report.commanded, report.executed
    if commanded is None or executed is None or not isinstance(scenario, Scenario):
        path = _source(report.stated)
        return {"path": figures.source_path(path, path, np.zeros(3)), "errors": None}
    # A trajectory from a file has no isocentre: the world's origin stands in.
    isocentre = np.array(getattr(scenario.trajectory, "isocentre_mm", (0.0, 0.0, 0.0)))
    return {
        "path": figures.source_path(_source(commanded), _source(executed), isocentre),
        "errors": figures.pose_errors_over_views(
            pose_errors(commanded, executed),
            np.asarray(report.clearance_mm, dtype=np.float64),
            scenario.motion.tolerance_mm,
            scenario.motion.clearance_mm,
        )
        if scenario.cell.kind == "arms"
        else None,
    }


def _source(poses: PosePairs | None) -> Floats:
    """Return the places of the source, (views, 3), mm."""
    assert poses is not None
    return np.array([pose.position for pose in poses.source])


def _machine(cell: AnyCell) -> dict[str, str]:
    """Return the machine that carries source and panel."""
    if isinstance(cell, GantryCell):
        machine = "Gantry" if cell.c_arm is None else "C-arm"
        return {machine: "source and panel exactly at their commanded poses"}
    return {"Arms": f"{cell.source_arm.label} (source), {cell.detector_arm.label} (detector)"}


def _setting(report: ReportData) -> dict[str, str]:
    """Return the experiment in a few lines."""
    scenario, panel = report.scenario, report.panel
    grid = scenario.reconstruction.volume_grid
    voxel = " × ".join(f"{edge:g}" for edge in dict.fromkeys(grid.voxel.tolist()))
    voxels = {"Grid": f"{' × '.join(map(str, grid.shape_xyz))} voxels of {voxel} mm"}
    if report.commanded is None or not isinstance(scenario, Scenario):
        return {
            "Views": f"{report.metrics['views']} of {panel.rows} × {panel.columns} pixels (rows × "
            f"columns) of {panel.pitch_u} × {panel.pitch_v} mm",
            **voxels,
        }
    apart = {**report.metrics, "warnings": ()}  # they stand above the figures
    return {
        "Specimen": ", ".join(f"{p.label} ({p.made_of})" for p in scenario.specimen.parts),
        **({"Motion": report.motion} if report.motion else {}),
        "Trajectory": f"{scenario.trajectory.kind}, {counted(report.metrics['views'], 'view')}"
        + _sweeps_in_words(report.metrics),
        **_machine(scenario.cell),
        **physics_in_words(scenario, *report.commanded[0], report.mas),
        "Reconstruction": with_results(scenario.reconstruction.in_words, apart),
        **voxels,
    }


def _sweeps_in_words(metrics: Mapping[str, Any]) -> str:
    """Return how a scan in sweeps ended; an empty text for all others."""
    changes = metrics.get("changes_rel")
    if changes is None:
        return ""
    each = ", ".join(f"{views}: {100 * change:.2g} %" for views, change in changes.items())
    course = f"; change of the volume since half the views, by views: {each}" if each else ""
    return f" of at most {metrics['planned_views']}{course}"


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
