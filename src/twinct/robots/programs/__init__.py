"""Motion plans as files for the controllers of real arms; a new format is one file."""

from twinct.robots.programs.languages import Language, language_named, languages
from twinct.robots.programs.program import Program, check_absent, program_of, write_program

__all__ = [
    "Language",
    "Program",
    "check_absent",
    "language_named",
    "languages",
    "program_of",
    "write_program",
]
