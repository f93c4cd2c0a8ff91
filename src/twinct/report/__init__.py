"""Results of a run: ``metrics.json`` for scripts, ``report.html`` for people."""

from twinct.report.algorithm_results import FOUND, found_of, with_found
from twinct.report.comparison import Compared, Comparison
from twinct.report.data import Another, CrossSection, ReportData, cross_sections
from twinct.report.measured_comparison import MeasuredComparison
from twinct.report.measured_page import MeasuredColumn, write_measured_report
from twinct.report.metrics import STAGES, build_metrics, plain
from twinct.report.page import draw_pictures, render_report, write_report
from twinct.report.physics import physics_in_words
from twinct.report.repetitions import StudyTrial
from twinct.report.study_page import (
    StudyAxis,
    StudyData,
    best_trials,
    render_study,
    write_study,
)

__all__ = [
    "FOUND",
    "STAGES",
    "Another",
    "Compared",
    "Comparison",
    "CrossSection",
    "MeasuredColumn",
    "MeasuredComparison",
    "ReportData",
    "StudyAxis",
    "StudyData",
    "StudyTrial",
    "best_trials",
    "build_metrics",
    "cross_sections",
    "draw_pictures",
    "found_of",
    "physics_in_words",
    "plain",
    "render_report",
    "render_study",
    "with_found",
    "write_measured_report",
    "write_report",
    "write_study",
]
