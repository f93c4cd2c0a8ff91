"""Cross-sections of a trial in one small file, to show the best trials without volumes."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from twinct.core.files.arrays import read_npz
from twinct.report import CrossSection
from twinct.runs.reconstruction_folder import MOST_SECTION_BYTES

_ARRAYS = ("reconstruction", "truth", "roi")


def packed_sections(sections: Mapping[str, CrossSection], mu_reference: float) -> bytes:
    """Pack cross-sections and the reference attenuation of the figures, 1/mm, into bytes."""
    arrays = {
        f"{plane}.{name}": getattr(section, name)
        for plane, section in sections.items()
        for name in _ARRAYS
    }
    planes = {name: (s.extent_mm, s.axes, s.position) for name, s in sections.items()}
    stream = io.BytesIO()
    told = json.dumps({"planes": planes, "mu_reference": mu_reference})
    np.savez_compressed(stream, told=told, **arrays)
    return stream.getvalue()


def read_sections(path: Path) -> tuple[dict[str, CrossSection], float]:
    """Read a file that ``packed_sections`` made.

    Raises:
        InputError: the file holds no arrays, or too many bytes.
    """
    arrays = read_npz(path, f"{path}: the cross-sections", MOST_SECTION_BYTES)
    data = json.loads(str(arrays["told"]))
    sections = {
        plane: CrossSection(
            *(arrays[f"{plane}.{name}"] for name in _ARRAYS),
            extent_mm=tuple(extent),
            axes=tuple(axes),
            position=position,
        )
        for plane, (extent, axes, position) in data["planes"].items()
    }
    return sections, data["mu_reference"]
