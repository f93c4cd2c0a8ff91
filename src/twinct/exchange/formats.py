"""All export formats by name, built in or from extensions."""

from __future__ import annotations

from functools import cache

from twinct.core.extensions import Registry
from twinct.exchange.astra import ASTRA
from twinct.exchange.cil import CIL
from twinct.exchange.format import Format
from twinct.exchange.leap import LEAP
from twinct.exchange.openct import OPENCT
from twinct.exchange.rtk import RTK
from twinct.exchange.tigre import TIGRE

FormatName = str
"""Name of a format, built in or from an extension."""

BUILT_IN = {form.name: form for form in (RTK, ASTRA, LEAP, CIL, TIGRE, OPENCT)}


@cache
def formats() -> Registry[Format]:
    """Return the formats that ``twinct export`` can write; they are looked up once per process."""
    return Registry("twinct.exports", Format, BUILT_IN)


def format_named(name: FormatName) -> Format:
    """Return a format by its name.

    Raises:
        InputError: no format has this name, or the package that offers it is broken.
    """
    return formats().named(name, "--to")
