"""Measured scans: import of images and geometry, and predictions beside the images."""

from twinct.measured.conventions import Ranking, try_conventions
from twinct.measured.description import Measured, read_description
from twinct.measured.driven import Driven, import_driven, is_driven
from twinct.measured.importing import ImportedScan, import_measured
from twinct.measured.sources import description_of, is_measured

__all__ = [
    "Driven",
    "ImportedScan",
    "Measured",
    "Ranking",
    "description_of",
    "import_driven",
    "import_measured",
    "is_driven",
    "is_measured",
    "read_description",
    "try_conventions",
]
