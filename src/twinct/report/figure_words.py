"""Titles, units and better values of figures, by dotted names such as "image.rmse_rel"."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from twinct.report.measured import KINDS
from twinct.report.page import image_figures, stage_title

Best = Literal["lower", "higher", "one", ""]
"""Better values: lower ones, higher ones, or values nearest to 1; empty if unknown."""


class FigureWords(NamedTuple):
    """Display of a figure: its value times a factor, in a unit, with a number of digits."""

    title: str
    unit: str
    factor: float = 1.0
    digits: int = 3
    meaning: str = ""
    best: Best = ""

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} / {self.unit}" if self.unit else self.title


_BEST: dict[Best, str] = {
    "one": "mean_bone_rel$|recovery$",
    "higher": "psnr|ssim|clearance|fraction$|^reached$|real_time_factor"
    "|cnr$|f[15]0_per_mm$|detectability",
    "lower": "rmse|error|seconds|width|streak|noise",
}
_UNITS = {"_mm_s": "mm/s", "_mm": "mm", "_deg": "deg"}
_STATISTICS = {"min": "smallest", "max": "largest", "mean": "mean", "std": "spread"}


def figure_words(name: str, reference: str = "bone") -> FigureWords:
    """Return a figure in words; an unknown figure gets the words of its name.

    Args:
        name: dotted, as in ``metrics.json``.
        reference: name of the material that image figures are relative to.
    """
    parts, of = name.split("."), ""
    if len(parts) > 2 and parts[0] in ("image_by_geometry", "geometries"):
        of = f"{parts[1]} geometry"
        parts = [*(["image"] if parts[0] == "image_by_geometry" else []), *parts[2:]]
    if parts[0] == "believed_minus_executed":
        of, parts = "believed minus executed", ["image", *parts[1:]]
    if parts[:2] == ["image", "zero"]:
        of, parts = "all zero", ["image", *parts[2:]]
    fitting: list[Best] = [best for best, key in _BEST.items() if re.search(key, name)]
    best = fitting[0] if fitting and not of.startswith(("believed minus", "all zero")) else ""
    if len(parts) == 4 and parts[0] == "image":
        kind = KINDS.get(parts[1], ())
        if one := next((one for one in kind if one.key == parts[3]), None):
            title = ", ".join(filter(None, [one.title, parts[2].replace("_", " "), of]))
            meaning = one.meaning.format(reference)
            return FigureWords(title, one.unit, one.factor, one.digits, meaning, best)
    image = {f"image.{shown.key}": shown for shown in image_figures(reference)}
    shown = image.get(".".join(parts))
    if shown is not None:
        title = f"{shown.title}, {of}" if of else shown.title
        return FigureWords(title, shown.unit, shown.factor, shown.digits, shown.meaning, best)
    if parts[0] == "seconds" and len(parts) == 2:
        return FigureWords(f"time: {stage_title(parts[1])}", "s", digits=1, best=best)
    unit, words = "", []
    for part in parts:
        ending = next((end for end in _UNITS if part.endswith(end)), "")
        unit = _UNITS.get(ending, unit)
        words.append(part.removesuffix(ending).replace("_", " "))
    if words[-1] in _STATISTICS:
        words.append(_STATISTICS[words.pop()])
    return FigureWords(", ".join([*words, *filter(None, [of])]), unit, best=best)
