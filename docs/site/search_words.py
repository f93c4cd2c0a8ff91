"""Sphinx extension: words of a page's ``keywords`` are searched like words of its title.

Sphinx indexes keywords as text, and each of them as one word: "double edges" would never be found.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from docutils import nodes


def keywords(doctree: nodes.document) -> set[str]:
    """Return the words of a page's keywords."""
    metas = [node for node in doctree.findall(nodes.meta) if node.get("name") == "keywords"]
    return {word for meta in metas for word in meta["content"].replace(",", " ").split()}


def add_words(app: Any) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Put the keywords of all pages into the index, before it is written; makes no page."""
    index = getattr(app.builder, "indexer", None)
    if index is not None:
        for page in sorted(app.env.found_docs):
            for word in sorted(keywords(app.env.get_doctree(page))):
                index._title_mapping.setdefault(index.lang.stem(word.lower()), set()).add(page)
    yield from ()


def setup(app: Any) -> dict[str, bool]:
    """Add the words when all pages are written."""
    app.connect("html-collect-pages", add_words)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
