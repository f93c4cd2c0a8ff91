"""Packed pieces of arrays: chunks, strips and tiles, whose bytes unpack to a stated size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.boundary import require_memory
from twinct.core.files.packed import require_unpacked
from twinct.core.files.streams import CODECS, require_stream

_SAME_SIZE = frozenset(
    ("bytes", "endian", "transpose", "shuffle", "delta", "bitround", "quantize", "crc32c")
    + ("fletcher32",)
)
"""Codecs that leave the number of bytes as it is, but for a checksum."""

_CHECKSUM_BYTES = {"crc32c": 4, "fletcher32": 4}

_MOST_FOLD = {"lzf": 88, "packbits": 64}
"""Largest ratios of codecs that may grow less than what is allowed: LZF copies at most 264 bytes
by 3, PackBits 128 by 2."""

_INDEX_ITEM_BYTES = 16
"""Offset and length of an inner chunk in the index of a shard (Zarr's sharding codec 1.0)."""


@dataclass(frozen=True)
class Packing:
    """Codecs of a chunk, strip or tile, and its size in memory.

    Attributes:
        size: bytes in memory.
        codecs: names of the codecs, in the order of writing.
        inner: packing of the chunks inside; None unless it is a shard of Zarr.
        count: number of chunks inside.
        index_at_end: the shard's index follows its chunks.
    """

    size: int
    codecs: tuple[str, ...]
    inner: Packing | None = None
    count: int = 1
    index_at_end: bool = True

    def require(self, data: bytes | memoryview, where: str, at_once: int = 1) -> None:
        """Check that data unpack to this size, and fit into the memory.

        Args:
            data: the packed bytes.
            where: beginning of messages.
            at_once: number of pieces that are unpacked at the same time.

        Raises:
            InputError: they unpack to more, or it cannot be known.
        """
        require_unpacked(len(data), self.size, where, copies=at_once)
        self._require(memoryview(data), where)

    def _require(self, data: memoryview, where: str) -> None:
        if self.inner is not None:
            for part in self._parts(data, where):
                self.inner._require(part, where)
            return
        packers = 0
        for codec in reversed(self.codecs):
            data = data[: max(len(data) - _CHECKSUM_BYTES.get(codec, 0), 0)]
            packers += codec not in _SAME_SIZE
            if codec in _MOST_FOLD:
                require_memory(where, _MOST_FOLD[codec] * len(data))
            elif codec in CODECS and packers == 1:
                require_stream(data, codec, self.size, where)
            elif codec not in _SAME_SIZE:
                raise InputError(
                    f"{where} is packed with {', '.join(self.codecs)}; expected one of "
                    f"{', '.join(sorted((*CODECS, *_MOST_FOLD)))}"
                )

    def _parts(self, data: memoryview, where: str) -> Iterator[memoryview]:
        size = _INDEX_ITEM_BYTES * self.count + sum(_CHECKSUM_BYTES.get(c, 0) for c in self.codecs)
        index = data[max(len(data) - size, 0) :] if self.index_at_end else data[:size]
        if len(index) < size:
            raise InputError(f"{where} is cut off: a shard without its index")
        for offset, length in np.frombuffer(index, "<u8", 2 * self.count).reshape(-1, 2).tolist():
            if offset < len(data):  # 2^64 - 1 marks what is not stored
                yield data[offset : offset + length]
