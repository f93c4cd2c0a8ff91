"""Text of others, such as names and messages, in the Markdown of the page."""

from __future__ import annotations

import re

_MARKS = re.compile(r"[!-/:-@\[-`{-~]")
"""All punctuation of ASCII, which alone has a meaning in Markdown and HTML."""


def plain(text: str) -> str:
    """Return Markdown that shows a text on one line as it is.

    The page's Markdown may hold HTML with scripts (viser does not remove them), and a run's folder
    may come from a stranger.
    """
    return _MARKS.sub(r"\\\g<0>", " ".join(text.split()))
