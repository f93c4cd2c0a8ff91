"""Cross-sections of a trial in one small file, so that the best can be shown without volumes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from twinct.files.writing import complete
from twinct.report import CrossSection

_ARRAYS = ("reconstruction", "truth", "roi")


def write_sections(path: Path, sections: dict[str, CrossSection], mu_reference: float) -> None:
    """Write them, with the attenuation that the figures are relative to, 1/mm."""
    arrays = {
        f"{plane}.{name}": getattr(section, name)
        for plane, section in sections.items()
        for name in _ARRAYS
    }
    planes = {name: (s.extent_mm, s.axes, s.position) for name, s in sections.items()}
    with complete(path) as draft, draft.open("wb") as stream:
        told = json.dumps({"planes": planes, "mu_reference": mu_reference})
        np.savez_compressed(stream, told=told, **arrays)


def read_sections(path: Path) -> tuple[dict[str, CrossSection], float]:
    """Read what ``write_sections`` wrote."""
    with np.load(path) as arrays:
        told = json.loads(str(arrays["told"]))
        sections = {
            plane: CrossSection(
                *(arrays[f"{plane}.{name}"] for name in _ARRAYS),
                extent_mm=tuple(extent),
                axes=tuple(axes),
                position=position,
            )
            for plane, (extent, axes, position) in told["planes"].items()
        }
    return sections, told["mu_reference"]
