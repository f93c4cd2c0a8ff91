"""Measured scans: import of images and geometry, reconstruction and judgement without a truth."""

from twinct.measured.comparing import compare_measured
from twinct.measured.conventions import Ranking, try_conventions
from twinct.measured.description import Measured, read_description
from twinct.measured.driven import Driven, import_driven, is_driven
from twinct.measured.importing import Imported, import_measured
from twinct.measured.sources import description_of, is_measured
from twinct.measured.volume_folder import (
    MeasuredVolume,
    is_measured_scan,
    reconstruct_measured,
    report_measured,
)

__all__ = [
    "Driven",
    "Imported",
    "Measured",
    "MeasuredVolume",
    "Ranking",
    "compare_measured",
    "description_of",
    "import_driven",
    "import_measured",
    "is_driven",
    "is_measured",
    "is_measured_scan",
    "read_description",
    "reconstruct_measured",
    "report_measured",
    "try_conventions",
]
