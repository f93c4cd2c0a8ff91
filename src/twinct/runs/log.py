"""Log file of a run."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from twinct.core.files.links import no_link


@contextmanager
def logged_to(path: Path) -> Generator[None, None, None]:
    """Append the package's log messages to a file for the duration of a block."""
    with open(path, "a", encoding="utf-8", opener=no_link) as stream:
        handler = logging.StreamHandler(stream)
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logger = logging.getLogger("twinct")
        level = logger.level
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        try:
            yield
        finally:
            logger.removeHandler(handler)
            logger.setLevel(level)
            handler.close()
