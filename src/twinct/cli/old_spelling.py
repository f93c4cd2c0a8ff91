"""Command lines of version 0.1 in today's spelling."""

from __future__ import annotations

import difflib
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from twinct.cli.calibrate import METHODS
from twinct.core.errors import InputError


def respelled(arguments: Sequence[str]) -> list[str]:
    """Return a command line with the method of ``twinct calibrate`` as a subcommand.

    In version 0.1 the method was an option, ``--with METHOD``, and beads without it. One line on
    stderr says what to write instead.

    Raises:
        InputError: there is no such method.
    """
    if arguments[:1] != ["calibrate"] or arguments[1:2] in ([], ["-h"], ["--help"]):
        return list(arguments)
    method, others, words = None, list[str](), iter(arguments[1:])
    for word in words:
        key, equals, value = word.partition("=")
        if key == "--with":
            method = value if equals else next(words, "")
        else:
            others.append(word)
    if method is None and (others[0] in METHODS or _mistyped(others)):
        return list(arguments)
    method = "beads" if method is None else method
    if method not in METHODS:
        raise InputError(f"--with {method}: unknown; choose from {', '.join(METHODS)}")
    new = ["calibrate", method, *others]
    sys.stderr.write(f"twinct: the method comes first now; write: {shlex.join(['twinct', *new])}\n")
    return new


def _mistyped(words: Sequence[str]) -> bool:
    """Return whether the first of several words is meant as the name of a method, not a folder."""
    before_folder = len(words) > 1 and not words[0].startswith("-") and not words[1].startswith("-")
    near = difflib.get_close_matches(words[0], METHODS, n=1)
    return before_folder or (bool(near) and not Path(words[0]).exists())
