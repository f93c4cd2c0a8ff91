"""Answers for scripts: one JSON object on stdout, and everything else on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from twinct.core.errors import InputError


@contextmanager
def answering(as_json: bool) -> Iterator[dict[str, Any]]:
    """Yield the object that is printed at the end, if scripts asked for it.

    What is printed meanwhile goes to stderr. Bad input is part of the answer, too, under
    ``problems``; the exit code is the same with and without ``--json``.
    """
    answer: dict[str, Any] = {}
    if not as_json:
        yield answer
        return
    stdout = sys.stdout
    try:
        with redirect_stdout(sys.stderr):
            yield answer
    except InputError as error:
        answer["problems"] = list(error.problems)
        _write(stdout, answer)
        raise
    _write(stdout, answer)


def _write(stream: Any, answer: dict[str, Any]) -> None:
    from twinct.report import plain

    stream.write(json.dumps(plain(answer), indent=2, allow_nan=False) + "\n")
