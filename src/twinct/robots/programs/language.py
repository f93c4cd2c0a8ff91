"""Kind of a format in which a motion plan is written for controllers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from twinct.robots.programs.program import Program


@dataclass(frozen=True, eq=False)
class Language:
    """Format that ``twinct motion --to`` can name.

    Attributes:
        name: value of ``--to``.
        title: controllers or programs that read the files, for the help.
        write: returns the text of each file, by name; raises InputError for a plan that the
            format cannot express.
    """

    name: str
    title: str
    write: Callable[[Program], Mapping[str, str]]
