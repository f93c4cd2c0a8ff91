"""Export of a scan to another reconstruction toolkit: RTK, ASTRA, LEAP, CIL, TIGRE, OpenCT.

Each toolkit has its own module with a ``Format`` that converts a ``ScanGeometry``. Coordinates are
in the grid's own frame, in which every grid is axis-aligned and centred on the origin. So the
toolkit need not support shifted or rotated grids.
"""

from twinct.exchange.bundle import bundle_bytes, write_bundle
from twinct.exchange.format import Bundle, Format, Values
from twinct.exchange.formats import BUILT_IN, FormatName, format_named, formats

__all__ = [
    "BUILT_IN",
    "Bundle",
    "Format",
    "FormatName",
    "Values",
    "bundle_bytes",
    "format_named",
    "formats",
    "write_bundle",
]
