"""Handing a scan to another reconstruction toolkit: RTK, ASTRA, LEAP, CIL, TIGRE, OpenCT.

Each toolkit has a file of its own that puts a ``ScanGeometry`` into its words. Coordinates are
those of the grid's own frame, in which every grid is axis-aligned and centred on the origin; so a
shifted or turned grid needs nothing of the toolkit.
"""

from twinct.exchange.bundle import TOOLKITS, Bundle, Toolkit, Values, bundle_bytes, write_bundle

__all__ = ["TOOLKITS", "Bundle", "Toolkit", "Values", "bundle_bytes", "write_bundle"]
