"""Reason why a file cannot be read."""

from __future__ import annotations


def reason(error: Exception) -> str:
    """Return the cause in words, without error numbers."""
    if isinstance(error, IsADirectoryError):
        return "it is a folder"
    if isinstance(error, UnicodeDecodeError):
        return "not UTF-8 text"
    return getattr(error, "strerror", None) or str(error)
