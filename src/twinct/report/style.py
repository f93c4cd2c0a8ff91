"""Colours, fonts and sizes that all pictures of a report share, and the type of a picture."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

SOURCE_COLOUR, DETECTOR_COLOUR = "#c4501b", "#1f6091"
LIMIT_COLOUR, REGION_COLOUR, INK = "#6b7280", "#f2a33a", "#1f2933"

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "axes.edgecolor": "#9aa5b1",
    "axes.linewidth": 0.8,
    "axes.titlesize": 9.5,
    "legend.fontsize": 8.5,
    **dict.fromkeys(("font.size", "axes.labelsize"), 9),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), 8),
    **dict.fromkeys(("axes.labelcolor", "text.color", "xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    "svg.hashsalt": "twinct",  # the same data gives the same bytes
}
WIDTH = 10.4
"""Width in inches; the page shows about 100 px per inch."""


@dataclass(frozen=True)
class Picture:
    """Image with its media type, such as "image/png"."""

    content: bytes
    media_type: str

    @property
    def data_uri(self) -> str:
        """Image as a data address, so that a page needs no other file."""
        return f"data:{self.media_type};base64,{base64.b64encode(self.content).decode('ascii')}"
