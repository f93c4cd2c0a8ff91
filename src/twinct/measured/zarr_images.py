"""Images in Zarr stores of any software, bounded before Zarr unpacks them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.files.zarr_chunks import Part, ZarrChunks
from twinct.measured.array_names import named_array


class ZarrImages:
    """An array of which each chunk is checked before Zarr unpacks it."""

    def __init__(self, array: Any, root: Path, where: str) -> None:
        """Take an array of a store in a local folder."""
        self._array, self._chunks = array, ZarrChunks(array, root, where)
        self.shape, self.dtype = tuple(array.shape), np.dtype(array.dtype)

    def __getitem__(self, index: Part) -> NDArray[Any]:
        """Return a part of the numbers.

        Raises:
            InputError: a chunk unpacks to more than it states, or to more than the memory.
        """
        self._chunks.require(index)
        return np.asarray(self._array[index])


def is_zarr(path: Path) -> bool:
    """Return True for the folder of a Zarr store, by its name or its own file."""
    return path.suffix.lower() == ".zarr" or (path / "zarr.json").is_file()


def open_zarr(path: Path, name: str, key: str) -> ZarrImages:
    """Open an array of a store by its name; the only one if the name is empty.

    Raises:
        InputError: there is no such array.
    """
    import zarr

    opened: Any = zarr.open(str(path), mode="r")
    if not isinstance(opened, zarr.Array):
        opened = named_array(dict(opened.arrays()), name, f"{key}: {path}")
    return ZarrImages(opened, path, f"{path}")
