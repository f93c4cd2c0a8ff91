"""Runs: from a scenario to a scan, a volume and its figures, in memory or in a folder."""

from twinct.runs.acquisition import acquire_to_store, machine_frames, simulate
from twinct.runs.checks import (
    check_geometries,
    check_physics,
    check_sight,
    findings,
    rehearse,
    require_extras,
)
from twinct.runs.compare import compare
from twinct.runs.export import export, export_scan
from twinct.runs.figures import Figures
from twinct.runs.folder import Folder
from twinct.runs.importing import import_recordings
from twinct.runs.job import Run, rewrite_report, run
from twinct.runs.needs import Need, needs, require_memory
from twinct.runs.reconstruction import derive_geometry, load_scan, reconstruct_run
from twinct.runs.reconstruction_folder import StoredReconstruction
from twinct.runs.reporting import evaluate, judge
from twinct.runs.truth import Truth, truth_of
from twinct.runs.verify import Verdict, verify
from twinct.runs.volume_export import Water, export_volume
from twinct.runs.volumes import reconstruct, require_feasible
from twinct.scan import line_integrals

__all__ = [
    "Figures",
    "Folder",
    "Need",
    "StoredReconstruction",
    "Run",
    "Truth",
    "Verdict",
    "Water",
    "acquire_to_store",
    "check_geometries",
    "check_physics",
    "check_sight",
    "compare",
    "derive_geometry",
    "evaluate",
    "export",
    "export_scan",
    "export_volume",
    "findings",
    "import_recordings",
    "judge",
    "line_integrals",
    "load_scan",
    "machine_frames",
    "needs",
    "require_memory",
    "reconstruct",
    "reconstruct_run",
    "rehearse",
    "rewrite_report",
    "require_extras",
    "require_feasible",
    "run",
    "simulate",
    "truth_of",
    "verify",
]
