"""Chunks of Zarr arrays that somebody else may have written: bounded before Zarr unpacks them.

Zarr makes what the metadata and the stream of a chunk state, and only then compares the two.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from types import EllipsisType
from typing import Any

import numpy as np

from twinct.core.files.boundary import file_bytes
from twinct.core.files.packing import Packing

Part = int | slice | EllipsisType | tuple[int | slice, ...]

_AT_ONCE = 10
"""Chunks that Zarr unpacks at the same time (``async.concurrency``)."""


class ZarrChunks:
    """The chunks of one array in a local folder.

    Attributes:
        packing: how each of them is packed.
    """

    def __init__(self, array: Any, root: Path, where: str) -> None:
        """Read how the chunks are packed.

        Args:
            array: the array, of Zarr version 2 or 3.
            root: folder of the store.
            where: beginning of messages.

        Raises:
            InputError: a chunk is larger than the memory.
        """
        self._array, self._where = array, where
        self._folder = root / array.path
        self._shape = tuple(array.shape)
        self._chunks = tuple(array.shards or array.chunks)
        self.packing = _packing(array)
        self._known: set[Path] = set()

    def require(self, which: Part) -> None:
        """Check the chunks of a part of the array; each file is read once.

        Raises:
            InputError: one unpacks to more than its array states, or to more than the memory.
        """
        parts = which if isinstance(which, tuple) else () if which is ... else (which,)
        ranges = [
            range(size)[part : part + 1 or None] if isinstance(part, int) else range(size)[part]
            for part, size in zip(parts, self._shape, strict=False)
        ]
        ranges += [range(size) for size in self._shape[len(ranges) :]]
        if not all(map(len, ranges)):
            return
        places = list(map(_chunk_range, ranges, self._chunks))
        at_once = min(_AT_ONCE, math.prod(map(len, places)))
        for at in itertools.product(*places):
            file = self._folder / self._array.metadata.encode_chunk_key(at)
            if file not in self._known and file.exists():
                self._require(file, at_once)
                self._known.add(file)

    def _require(self, file: Path, at_once: int) -> None:
        where = f"{self._where}: its chunk {file.relative_to(self._folder)}"
        # Zarr reads the whole file; incompressible data grow by less than a tenth.
        whole = self.packing.size + self.packing.size // 10 + 2**16
        file_bytes(file, where, whole)
        self.packing.require(file.read_bytes(), where, at_once)


def _chunk_range(indices: range, edge: int) -> range:
    return range(min(indices) // max(edge, 1), max(indices) // max(edge, 1) + 1)


def _packing(array: Any) -> Packing:
    metadata, item = array.metadata, np.dtype(array.dtype).itemsize
    size = item * math.prod(array.chunks)
    if metadata.zarr_format == 2:
        packers = (
            *(metadata.filters or ()),
            *([metadata.compressor] if metadata.compressor else ()),
        )
        return Packing(size, tuple(packer.codec_id for packer in packers))
    codecs = [codec.to_dict() for codec in metadata.codecs]
    if array.shards is None:
        return Packing(size, _names(codecs))
    shard = item * math.prod(array.shards)
    sharding = next((c for c in codecs if c["name"] == "sharding_indexed"), None)
    if sharding is None or len(codecs) > 1:
        return Packing(shard, _names(codecs))
    keys = sharding["configuration"]
    inner = Packing(size, _names(keys["codecs"]))
    count = math.prod(-(-s // c) for s, c in zip(array.shards, array.chunks, strict=True))
    at_end = str(keys.get("index_location", "end")).endswith("end")
    return Packing(shard, _names(keys["index_codecs"]), inner, count, at_end)


def _names(codecs: Sequence[Any]) -> tuple[str, ...]:
    return tuple(str(codec["name"]).removeprefix("numcodecs.") for codec in codecs)
