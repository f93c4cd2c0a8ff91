"""Text from outside: the numbers in it, and its place in messages.

``int`` and ``float`` also take digits of other scripts and underscores, ``str.isdigit`` takes
digits that ``int`` refuses, and ``int`` refuses long texts. Here a digit is one of 0 to 9.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_WHOLE = re.compile(r"[0-9]{1,18}")
"""Digits of a number below 2^63."""

LONGEST_REASON = 300
"""Largest number of characters of a library's message."""

MOST_PROBLEMS = 10
"""Largest number of problems that a message states; a count of the others follows."""

LONGEST_PROBLEM = 900
"""Largest number of characters of one of several problems; longer ones lose their middle."""

LONGEST_MESSAGE = 1800
"""Largest number of characters of all problems that a message states."""


def whole_number(text: str) -> int | None:
    """Return the number that up to 18 digits form; None for any other text."""
    return int(text) if _WHOLE.fullmatch(text) else None


def number(text: str) -> float:
    """Return the number that a text of ASCII characters states; it may be infinite or NaN.

    Raises:
        ValueError: the text is no number; says so in one sentence.
    """
    try:
        if text.isascii() and "_" not in text:
            return float(text)
    except ValueError:
        pass
    raise ValueError(f"{quoted(text)} is not a number")


def shortened(text: str, most: int = LONGEST_REASON) -> str:
    """Return a text on one line, shortened at its end if it is long."""
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[: most - 3]}..."


def quoted(value: object, most: int = 80) -> str:
    """Return a value as Python writes it, on one line and shortened if it is long."""
    if isinstance(value, str | bytes):
        value = value[: most + 1]
    try:
        return shortened(repr(value), most)
    except ValueError:  # Python writes no integers of more than 4,300 digits
        return "a number of thousands of digits"


def stated(problems: Sequence[str], more: int = 0) -> list[str]:
    """Return the first problems, as many as a message has room for, and a count of the others.

    Args:
        problems: one sentence each.
        more: number of further problems that nobody has put into words.
    """
    lines: list[str] = []
    longest = LONGEST_MESSAGE if len(problems) == 1 else LONGEST_PROBLEM
    for problem in problems[:MOST_PROBLEMS]:
        if len(problem) > longest:
            half = longest // 2 - 3
            problem = f"{problem[:half]} ... {problem[-half:]}"
        if lines and sum(map(len, lines)) + len(problem) > LONGEST_MESSAGE:
            break
        lines.append(problem)
    if left := len(problems) - len(lines) + more:
        lines.append(f"and {left} more {'problem' if left == 1 else 'problems'}")
    return lines


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, as in 1 view and 2 views."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
