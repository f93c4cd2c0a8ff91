"""Sphinx extension: leave at each former address of a page a page that leads to the new one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.errors import ExtensionError

HERE = Path(__file__).parent
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Moved</title>
<link rel="canonical" href="{new}"><meta http-equiv="refresh" content="0; url={new}"></head>
<body>This page has moved: <a href="{new}">{new}</a></body></html>
"""


def moved(file: Path = HERE / "moved.txt") -> dict[str, str]:
    """Return the new address of each former page, without suffixes: page, or page#heading."""
    lines = file.read_text(encoding="utf-8").splitlines()
    return dict(line.split() for line in lines if line and not line.startswith("# "))


def write_moved(addresses: dict[str, str], site: Path) -> None:
    """Write the pages at the former addresses.

    Raises:
        ExtensionError: a former page is still there, or a new one is not.
    """
    for old, new in addresses.items():
        page, _, heading = new.partition("#")
        file = site / f"{old}.html"
        if not (site / f"{page}.html").exists() or file.exists():
            raise ExtensionError(f"docs/site/moved.txt: {old} {new}: wrong address")
        up = "../" * old.count("/")
        link = f"{up}{page}.html" + (f"#{heading}" if heading else "")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(PAGE.format(new=link), encoding="utf-8")


def setup(app: Any) -> dict[str, Any]:
    """Register the extension."""

    def finished(app: Any, exception: Exception | None) -> None:
        if exception is None and app.builder.name == "html":
            for old in moved():
                (Path(app.outdir) / f"{old}.html").unlink(missing_ok=True)  # of an earlier build
            write_moved(moved(), Path(app.outdir))

    app.connect("build-finished", finished)
    return {"parallel_read_safe": True}
