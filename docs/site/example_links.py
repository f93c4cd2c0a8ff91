"""Sphinx extension: below each function and class, link the programs that import it."""

from __future__ import annotations

import ast
import functools
import importlib
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FOLDERS = ("tutorials", "gallery")
SHOWN = 6
"""Programs that are linked; half of the gallery begins with the same three functions."""


@functools.cache
def programs() -> dict[tuple[str, str], list[str]]:
    """Return, by module and name of each function and class, links to the programs with it."""
    found: dict[tuple[str, str], list[str]] = {}
    for file in (file for folder in FOLDERS for file in sorted((EXAMPLES / folder).glob("*.py"))):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        title = (ast.get_docstring(tree) or file.stem).partition("\n")[0]
        link = f":doc:`{title} </{file.parent.name}/{file.stem}>`"
        for one in {_key(*names) for names in _imported(tree)}:
            found.setdefault(one, []).append(link)
    return found


def _imported(tree: ast.Module) -> set[tuple[str, str]]:
    return {
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("twinct")
        for alias in node.names
    }


def _key(module: str, name: str) -> tuple[str, str]:
    """Return where an imported object is defined, since pages show it from there."""
    one = getattr(importlib.import_module(module), name)
    return getattr(one, "__module__", module), getattr(one, "__qualname__", name)


def add_links(app: Any, what: str, name: str, one: Any, options: Any, lines: list[str]) -> None:
    """Append the links to the docstring of an object."""
    key = (getattr(one, "__module__", ""), getattr(one, "__qualname__", ""))
    if what in ("function", "class") and (links := programs().get(key)):
        more = f", and {len(links) - SHOWN} more" if len(links) > SHOWN else ""
        lines += ["", f"Programs with it: {', '.join(links[:SHOWN])}{more}", ""]


def setup(app: Any) -> dict[str, bool]:
    """Register the extension with Sphinx."""
    app.connect("autodoc-process-docstring", add_links, priority=900)  # after napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}
