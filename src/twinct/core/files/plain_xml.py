"""XML in files of any origin: without entities, which may grow or name other files."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree


class _Plain(ElementTree.TreeBuilder):
    def doctype(self, *_: object) -> None:
        raise ValueError("it has a DOCTYPE, which is not needed: remove it")


def xml_of(text: str | bytes) -> Any:
    """Return the root of an XML text without a document type.

    Raises:
        ValueError: the text is no such XML.
    """
    return _root(text, ElementTree.XMLParser(target=_Plain()))


def xml_with_doctype(text: str) -> Any:
    """Return the root of an XML text that may name a document type, as ITK does, but no entities.

    Raises:
        ValueError: the text is no such XML.
    """
    if "<!ENTITY" in text:
        raise ValueError("it defines entities")
    return _root(text, ElementTree.XMLParser())


def _root(text: str | bytes, parser: Any) -> Any:
    try:
        return ElementTree.fromstring(text, parser)
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(str(error)) from None
