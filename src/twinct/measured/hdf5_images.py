"""Images in HDF5 files that lie in the file itself: bounded, and no other file is opened."""

from __future__ import annotations

import importlib
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.packing import Packing
from twinct.core.foreign_text import quoted
from twinct.measured.array_names import array_name

HDF5 = (".h5", ".hdf5", ".hdf", ".nxs", ".nx")
"""Endings of HDF5 files, those of Data Exchange and NeXus among them."""

_FILTERS = {1: "zlib", 2: "shuffle", 3: "fletcher32", 4: "szip", 32000: "lzf"}
"""Filters that are read, by HDF5's numbers; their output is limited before HDF5 applies them."""

_MOST_LINKS = 16
"""Longest chain of soft links, as for HDF5 itself."""
_LONGEST_PATH = 4096
"""Characters of another file's name in a message; Linux takes no longer path."""

Index = tuple[int | slice, ...]


class Hdf5Images:
    """A dataset of which each piece is checked before HDF5 unpacks it."""

    def __init__(self, dataset: Any, where: str) -> None:
        """Check where and how the numbers of a dataset are stored.

        Raises:
            InputError: they are in other files, or packed by a filter that is not read.
        """
        self._dataset, self._where = dataset, where
        if external := dataset.external:
            raise _elsewhere(where, dataset.name, [str(name) for name, _, _ in external])
        if dataset.is_virtual:
            others = [str(source.file_name) for source in dataset.virtual_sources()]
            raise _elsewhere(where, dataset.name, others)
        self.shape, self.dtype = tuple(dataset.shape or ()), np.dtype(dataset.dtype)
        chain = dataset.id.get_create_plist()
        filters = [int(chain.get_filter(k)[0]) for k in range(chain.get_nfilters())]
        if unknown := [number for number in filters if number not in _FILTERS]:
            raise InputError(
                f"{where}: {dataset.name} is packed by HDF5's filter {unknown[0]}, which is not "
                "read: h5repack -f GZIP=4 writes a file that is"
            )
        self._filters = [_FILTERS[number] for number in filters]
        self._known: set[tuple[int, ...]] = set()

    def __getitem__(self, index: Index) -> NDArray[Any]:
        """Return a part of the numbers.

        Raises:
            InputError: a chunk unpacks to more than it states, or to more than the memory.
        """
        if self._filters and self._dataset.chunks:
            self._require(index if isinstance(index, tuple) else (index,))
        return np.asarray(self._dataset[index])

    def _require(self, index: Index) -> None:
        edges = self._dataset.chunks
        parts = (*index, *[slice(None)] * (len(edges) - len(index)))
        starts = [
            range(0, size, edge) if isinstance(part, slice) else (part // edge * edge,)
            for part, size, edge in zip(parts, self.shape, edges, strict=True)
        ]
        size = self.dtype.itemsize * math.prod(edges)
        for start in itertools.product(*starts):
            if start in self._known:
                continue
            stored = self._dataset.id.get_chunk_info_by_coord(start)
            if stored.byte_offset is not None:
                where = f"{self._where}: {self._dataset.name}: its chunk at {start}"
                # A filter that did not shrink a chunk may be left out for it.
                applied = [
                    name for k, name in enumerate(self._filters) if not stored.filter_mask >> k & 1
                ]
                _, data = self._dataset.id.read_direct_chunk(start)
                Packing(size, tuple(applied)).require(data, where)
            self._known.add(start)


def open_hdf5(path: Path, name: str, key: str) -> Hdf5Images:
    """Open a dataset of a file by its name; the only one if the name is empty.

    Args:
        path: the file.
        name: path of the dataset in the file, without a leading slash.
        key: key of the description, for messages.

    Raises:
        InputError: there is no such dataset, or its numbers are in another file.
        MissingExtraError: HDF5 needs a package that is not installed.
    """
    require("hdf5")
    h5py: Any = importlib.import_module("h5py")
    where = f"{path}"
    file = h5py.File(path, "r")
    names: list[str] = []
    file.visititems(
        lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None
    )
    links: dict[str, Any] = {}
    file.visititems_links(
        lambda name, link: (
            links.update({name: link})
            if isinstance(link, h5py.ExternalLink | h5py.SoftLink)
            else None
        )
    )
    name = _followed(name, links, h5py.ExternalLink, where)
    outside = sorted({link.filename for link in links.values() if hasattr(link, "filename")})
    if not names and outside:
        raise _elsewhere(where, "all that it holds", outside)
    return Hdf5Images(file[array_name(names, name, f"{key}: {where}")], where)


def _followed(name: str, links: dict[str, Any], external: type, where: str) -> str:
    """Return the name behind soft links; links to other files are not followed."""
    for _ in range(_MOST_LINKS):
        parts = name.split("/")
        heads = ["/".join(parts[: k + 1]) for k in range(len(parts))]
        head = next((head for head in heads if head in links), None)
        if head is None:
            return name
        link = links[head]
        if isinstance(link, external):
            raise _elsewhere(where, head, [link.filename])
        base = "" if link.path.startswith("/") else head.rpartition("/")[0] + "/"
        name = f"{base}{link.path}".strip("/") + name[len(head) :]
    raise InputError(f"{where}: {quoted(name)} leads from link to link")


def _elsewhere(where: str, name: str, files: list[str]) -> InputError:
    others = ", ".join(quoted(file, _LONGEST_PATH) for file in dict.fromkeys(files[:3]))
    more = f" and {len(files) - 3} more" if len(files) > 3 else ""
    return InputError(
        f"{where}: {name} is in another file, {others}{more}; other files are not opened for it: "
        "name that file, or copy the images into one file"
    )
