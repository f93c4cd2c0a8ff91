"""The files of a scan store as Zarr sees them: compared with the manifest whenever one is read."""

from __future__ import annotations

from pathlib import Path

from zarr.abc.store import ByteRequest
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.storage import LocalStore

from twinct.core.files.packing import Packing
from twinct.core.files.plain_json import read_json
from twinct.scan.manifest import (
    ACQUIRED,
    FOLDER,
    ROOT,
    VIEWS,
    Damage,
    damaged,
    digest_of,
    lost,
    read_row,
    row_file,
    sealed,
    view_of,
)
from twinct.scan.metadata import with_legal_chunks


class CheckedStore(LocalStore):
    """Files of a scan store, which checks each chunk of a view when it is read.

    Attributes:
        packings: packing of the chunks of a view by array, which bounds what Zarr unpacks.

    A missing chunk, which Zarr would read as fill values, counts as damage even in a store without
    a manifest.
    """

    def __init__(self, root: Path, *, read_only: bool = False) -> None:
        """Open the files of a store whose frame the caller has checked."""
        super().__init__(root, read_only=read_only)
        self._has_manifest = (root / FOLDER).is_dir()
        self._rows: dict[int, dict[str, str]] = {}
        self._noted: dict[str, str] = {}
        self.packings: dict[str, Packing] = {}
        if self._has_manifest:
            metadata = read_json(root / VIEWS / "zarr.json")
            self._width = int(metadata["shape"][1])
            self._root = {ROOT: digest_of((root / ROOT).read_bytes())}

    def get_sync(
        self,
        key: str,
        *,
        prototype: BufferPrototype | None = None,
        byte_range: ByteRequest | None = None,
    ) -> Buffer | None:
        """See ``LocalStore``.

        Raises:
            DamagedError: the file is damaged.
            InputError: it unpacks to more than its array states.
        """
        found = None
        if self._is_file(key):
            found = super().get_sync(key, prototype=prototype, byte_range=byte_range)
        return self._checked(key, found, whole=byte_range is None)

    async def get(
        self,
        key: str,
        prototype: BufferPrototype | None = None,
        byte_range: ByteRequest | None = None,
    ) -> Buffer | None:
        """See ``get_sync``; Zarr before 3.1.6 reads by this function alone."""
        found = None
        if self._is_file(key):
            found = await super().get(key, prototype, byte_range)
        return self._checked(key, found, whole=byte_range is None)

    def _is_file(self, key: str) -> bool:
        """Return False for a pipe too, which would block until somebody writes."""
        return (self.root / key).is_file()

    def _checked(self, key: str, data: Buffer | None, *, whole: bool) -> Buffer | None:
        """Return data of a file, checked; ``whole``: all its bytes were asked for."""
        if data is not None and whole and key.rpartition("/")[2] == ROOT:
            data = type(data).from_bytes(with_legal_chunks(data.to_bytes()))
        if (view := view_of(key)) is not None and not key.startswith(FOLDER):
            self._check(key, view, None if data is None else data.to_bytes())
            packing = self.packings.get(key.rpartition("/")[0])
            if packing is not None and data is not None:
                packing.require(data.to_bytes(), f"{self.root}/{key}")
        return data

    async def set(self, key: str, value: Buffer) -> None:
        """See ``LocalStore``; also note the digest for the manifest."""
        self.note(key, value.to_bytes())
        await super().set(key, value)

    def _check(self, file: str, view: int, data: bytes | None) -> None:
        if file.startswith("status/"):
            whole = data in (None, ACQUIRED)
        elif data is None:
            raise damaged(self.root, lost(self.root, file, view) or Damage(file, "missing", view))
        else:
            whole = not self._has_manifest or self._row(view).get(file) == digest_of(data)
        if not whole:
            raise damaged(self.root, Damage(file, "changed", view))

    def _row(self, view: int) -> dict[str, str]:
        if view not in self._rows:
            self._rows[view] = read_row(self.root, view)
        return self._rows[view]

    def note(self, file: str, data: bytes) -> None:
        """Note the digest of a view's file for the manifest."""
        self._noted[file] = digest_of(data)

    def seal(self, view: int) -> None:
        """Complete a view: write all noted digests to its row of the manifest."""
        row, self._noted = self._noted, {}
        if self._has_manifest:
            (self.root / row_file(view)).write_bytes(sealed(self._root | row, self._width))
            self._rows[view] = row
