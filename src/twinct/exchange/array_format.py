"""Formats of two NumPy files: the toolkit's own arguments, and the projections."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.exchange.format import Bundle, Format, own_script, reconstruct_usage
from twinct.exchange.stack import write_npy
from twinct.geometry import ScanGeometry, VolumeGrid


def array_format(
    name: str,
    title: str,
    arrays: Callable[[ScanGeometry, VolumeGrid], dict[str, NDArray[Any]]],
    check: Callable[[Bundle], object] = lambda bundle: None,
) -> Format:
    """Return a format that stores a toolkit's arguments under the toolkit's own names.

    Args:
        name: value of ``--to``, and name of the program in ``scripts``.
        title: see ``Format``.
        arrays: arguments by name, from the views in the grid's own frame and the grid.
        check: see ``Format``.
    """

    def write(bundle: Bundle, folder: Path) -> None:
        words = arrays(bundle.local, bundle.grid)
        np.savez(folder / "geometry.npz", allow_pickle=False, **words)
        write_npy(folder / "projections.npy", bundle)

    described = {
        "projections.npy": "NumPy array (view, row, column), float32",
        "geometry.npz": "one array for each argument, by the toolkit's own names",
    }
    script = own_script(name)
    return Format(name, title, described, write, script, check, usage=reconstruct_usage)
