"""Results of a run: ``metrics.json`` for scripts, ``report.html`` for people."""

from twinct.core.renamed import old_names
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

_STUDY = "StudyAxis", "StudyData", "best_trials", "render_study", "write_study"

__getattr__ = old_names(
    __name__,
    {
        "FOUND": "ALGORITHM_RESULTS",
        "StudyTrial": "twinct.report.repetitions.StudyTrial",
        "found_of": "algorithm_results",
        "with_found": "with_results",
        **{name: f"twinct.report.study_page.{name}" for name in _STUDY},
    },
)
