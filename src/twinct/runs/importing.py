"""Import of a scan from its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from twinct.core.files.lock import sole_owner
from twinct.core.files.writing import complete, storage_errors
from twinct.runs.folder import Folder
from twinct.scan import store_geometries

if TYPE_CHECKING:
    from twinct.link.recording import ForeignScan, RecoveredScan


def import_recordings(paths: Sequence[str | Path], out: str | Path) -> RecoveredScan | ForeignScan:
    """Create a run's folder from recordings of a scan.

    ``run(..., resume=True)`` acquires the views that are missing. Raw, flat and dark images are not
    recorded: they are rendered again if ``detector.keep`` requests them. A recording by another
    tool becomes an imported scan, as measured images do.

    Args:
        paths: recordings of one scan, by twinct or by another tool with the same topics.
        out: the folder, without a run in it.

    Raises:
        InputError: a file is no recording, or there is no complete view; nothing is written.
        MissingExtraError: the extra ``record`` is not installed.
        ScanExistsError: the folder holds a scan.
        StorageError: the folder cannot be written.
    """
    from twinct.link.recording import read_recordings

    folder = Folder(Path(out))
    folder.refuse_others()
    folder.refuse_if_taken(resumes=False)
    recorded = read_recordings([Path(path) for path in paths])
    with storage_errors(folder.path):
        folder.path.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            stack.enter_context(sole_owner(folder.lock))
            imager = recorded.imager()
            if imager is not None:
                stack.enter_context(imager)
            # The scan comes last: without it, an import that was cut short can be repeated.
            draft = stack.enter_context(complete(folder.scan))
            recorded.rebuild(draft, imager)
            folder.write_scenario(recorded.settings)
            store_geometries((one, folder.geometries) for one in recorded.geometries)
    return recorded
