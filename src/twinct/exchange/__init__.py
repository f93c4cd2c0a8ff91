"""Export of a scan to another reconstruction toolkit: RTK, ASTRA, LEAP, CIL, TIGRE, OpenCT.

Each toolkit has its own module that converts a ``ScanGeometry``. Coordinates are in the grid's own
frame, in which every grid is axis-aligned and centred on the origin. So the toolkit need not
support shifted or rotated grids.
"""

from twinct.exchange.bundle import TOOLKITS, Bundle, Toolkit, Values, bundle_bytes, write_bundle

__all__ = ["TOOLKITS", "Bundle", "Toolkit", "Values", "bundle_bytes", "write_bundle"]
