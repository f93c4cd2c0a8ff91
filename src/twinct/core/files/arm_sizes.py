"""Limits of the pictures, fields and copies that short words in the description of an arm state."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from twinct.core.errors import ScenarioError
from twinct.core.files.boundary import library_errors
from twinct.core.files.images import stated_shape
from twinct.core.files.packed import ALWAYS_UNPACKED, require_unpacked
from twinct.core.foreign_text import number

_COLOURS, _SIDES, _BODY_BYTES = 4, 6, 2**13
"""Bytes of a pixel, pictures of a cube, and an upper estimate of what one body of a model takes."""

_PICTURES = {
    "texture": (("width", "height"), _COLOURS * _SIDES),
    "hfield": (("nrow", "ncol"), 4),
}
"""Attributes by element whose product MuJoCo makes, and the bytes of each."""

_COPIES = ("replicate", "composite", "flexcomp")
"""Elements that stand for ``count`` bodies; they may lie inside each other."""


def require_small(root: Any, where: str) -> None:
    """Check what MuJoCo makes of the elements of a model.

    Raises:
        ScenarioError: an element stands for more than is read of any packed file.
    """
    copies = _BODY_BYTES
    for element in root.iter():
        if element.tag in _PICTURES:
            names, octets = _PICTURES[element.tag]
            _require(octets * math.prod(_numbers(element, n) for n in names), element, where)
        elif element.tag in _COPIES:
            copies *= _numbers(element, "count")
            _require(copies, element, where)


def _numbers(element: Any, name: str) -> float:
    """Return the product of the numbers in an attribute; MuJoCo refuses what is no number."""
    product = 1.0
    for word in element.get(name, "1").split():
        try:
            product *= max(number(word), 1.0)
        except ValueError:
            continue
    return product


def _require(octets: float, element: Any, where: str) -> None:
    if octets > ALWAYS_UNPACKED:
        raise ScenarioError(
            f"{where}: its element <{element.tag}> makes {octets:.3g} bytes of a model; the limit "
            f"is {ALWAYS_UNPACKED}"
        )


def require_picture(path: Path, where: str) -> None:
    """Check the size that a picture of a texture or a height field states.

    Raises:
        InputError: the picture is none, or larger than its file or the memory allows.
    """
    told = f"{where}: {path.name}"
    with library_errors(told, ScenarioError):
        rows, columns = stated_shape(path, told)
    require_unpacked(path.stat().st_size, _COLOURS * rows * columns, told, ScenarioError)
