"""Studies: many scans from one file, without duplicate work, and resumable after any failure."""

from twinct.study.design import Design, Trial, load_study
from twinct.study.driver import Tally
from twinct.study.estimate import Estimate
from twinct.study.results import load_results
from twinct.study.running import DryRun, StudyRun, dry_run, merge_study, run_study

__all__ = [
    "Design",
    "DryRun",
    "Estimate",
    "StudyRun",
    "Tally",
    "Trial",
    "dry_run",
    "load_results",
    "load_study",
    "merge_study",
    "run_study",
]
