"""Export formats: a name, the files, the limits, and a script that loads the files.

Each format's file ends with its ``Format``. Formats from outside the package come from the entry
points of the group ``twinct.exports``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry, VolumeGrid

Image = NDArray[np.float32]
Values = Literal["line-integrals", "transmission"]


@dataclass(frozen=True, eq=False)
class Bundle:
    """Data of a scan to export.

    Attributes:
        geometry: the views in world coordinates.
        grid: voxel grid of the reconstruction.
        images: one image (rows, columns) per view, float32, in the order of ``geometry``; they can
            be read once.
        values: quantity in the pixels.
        origin: source of the data, for the text files.
    """

    geometry: ScanGeometry
    grid: VolumeGrid
    images: Iterable[Image]
    values: Values
    origin: dict[str, str]

    @property
    def local(self) -> ScanGeometry:
        """Views in the grid's own frame: axis-aligned, centred on the origin."""
        return self.grid.world_from_grid.inverse() @ self.geometry


@dataclass(frozen=True, eq=False)
class Format:
    """Export format that ``twinct export --to`` can name.

    Attributes:
        name: value of ``--to``.
        title: toolkit or programs that read the files, for the help and the README.
        files: names of the files that ``write`` writes, each with its content in a few words.
        write: writes geometry and projections of a scan into an empty folder.
        script: text of the Python program ``load.py``, which loads the folder.
        check: raises InputError, before anything is written, for a grid or a view that the toolkit
            does not support.
        usage: paragraphs of the README on using the files.
        ending: last paragraphs of the README.
    """

    name: str
    title: str
    files: Mapping[str, str]
    write: Callable[[Bundle, Path], object]
    script: str
    check: Callable[[Bundle], object] = lambda bundle: None
    usage: Callable[[VolumeGrid], str] = lambda grid: ""
    ending: Callable[[VolumeGrid], str] = lambda grid: ""

    def __post_init__(self) -> None:
        """Check the name, which becomes part of a folder's name.

        Raises:
            ValueError: the name has other characters than letters, digits, hyphens, underscores.
        """
        if not re.fullmatch(r"[A-Za-z0-9_-]+", self.name):
            raise ValueError(f"name {self.name!r}: use letters, digits, hyphens and underscores")


def own_script(name: str) -> str:
    """Return the text of a program in the folder ``scripts``."""
    script = files("twinct.exchange").joinpath("scripts", f"{name}.py")
    return script.read_text(encoding="utf-8")


def reconstruct_usage(grid: VolumeGrid) -> str:
    """Return how ``load.py`` reconstructs, if it takes ``--iterations`` and ``--out``."""
    voxels = " x ".join(map(str, grid.shape))
    edges = " x ".join(f"{edge:g}" for edge in grid.voxel)
    return f"""
    python load.py --iterations 10 --out volume.npy

reconstructs it and writes the volume as (z, y, x): {voxels} voxels, {edges} mm along
(x, y, z), in 1/mm. twinct's own volume of the same scan lies on the same voxels, in the same order.

Columns run along +u, rows along +v of the panel; row 0, column 0 is the corner at -u, -v. Pixel
(row, column) is centred at D + (column - (columns - 1)/2) pitch u + (row - (rows - 1)/2) pitch v, D
the panel's centre.
"""
