"""Results of a run: ``metrics.json`` for scripts, ``report.html`` for people."""

from twinct.report.algorithm_results import ALGORITHM_RESULTS, algorithm_results, with_results
from twinct.report.comparison import Compared, Comparison
from twinct.report.data import Another, CrossSection, ReportData, cross_sections
from twinct.report.metrics import STAGES, build_metrics, plain
from twinct.report.page import draw_pictures, render_report, write_report
from twinct.report.physics import physics_in_words

__all__ = [
    "ALGORITHM_RESULTS",
    "STAGES",
    "Another",
    "Compared",
    "Comparison",
    "CrossSection",
    "ReportData",
    "build_metrics",
    "cross_sections",
    "draw_pictures",
    "algorithm_results",
    "physics_in_words",
    "plain",
    "render_report",
    "with_results",
    "write_report",
]
