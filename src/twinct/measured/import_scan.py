"""Import of a scan, whatever its sources are: measured images, or recordings of messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.writing import storage_errors
from twinct.core.foreign_text import counted
from twinct.link.recording.arms_recording import ArmsRecording
from twinct.measured import conventions
from twinct.measured.driven import import_driven, is_driven
from twinct.measured.importing import import_measured
from twinct.measured.sources import description_of, is_measured
from twinct.observers import Audience, Observers, audience_of
from twinct.runs.folder import Folder
from twinct.runs.importing import import_recordings


@kinds_checked
def import_scan(
    sources: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    try_conventions: bool = False,
    arms: ArmsRecording = ArmsRecording(),  # noqa: B008 - frozen
    observers: Observers = (),
) -> Path:
    """Import a measured scan, or a scan's recordings, and return its folder.

    A measured scan has images and a geometry, but no truth. Several recordings belong to one scan
    that was interrupted and resumed; ``run(..., resume=True)`` acquires missing views.

    Args:
        sources: YAML description of a measured scan, folder of ``twinct export``, .xtekct or OpenCT
            file; or recordings.
        out: folder to write, without a run in it.
        try_conventions: for a measured scan: import nothing, but try other conventions, rank them,
            and show them in tried.png.
        arms: choices for recordings of real arms.
        observers: notified of the progress, and of all that is read, with units.

    Raises:
        InputError: a source is none, or does not state what a scan needs; nothing is written.
        MissingExtraError: the extra ``record`` is not installed.
        ScanExistsError: the folder holds a scan.
        StorageError: the folder cannot be written.
    """
    files = [Path(one) for one in ([sources] if isinstance(sources, str | Path) else sources)]
    out = Path(out)
    with audience_of(observers) as audience:
        if any(map(is_measured, files)):
            if len(files) > 1:
                raise InputError(f"{len(files)} sources: a measured scan has one; omit {files[1]}")
            (_rank if try_conventions else _measured)(files[0], out, audience)
        elif try_conventions:
            names = ", ".join(map(str, files))
            raise InputError(f"--try: only for a measured scan, not for {names}")
        elif not _driven(files, out, arms, audience):
            _recorded(files, out, audience)
    return out


def _measured(source: Path, out: Path, audience: Audience) -> None:
    imported = import_measured(description_of(source), out, audience)
    for sentence in imported.notes:
        audience.say(sentence)
    for doubt in imported.doubts:
        audience.say(doubt, warning=True)
    picture = Folder(out).imported
    audience.say(f"imported to {out}; {picture} shows it, 'twinct reconstruct {out}' goes on")


def _rank(source: Path, out: Path, audience: Audience) -> None:
    folder = Folder(out)
    folder.refuse_others()
    ranking = conventions.try_conventions(description_of(source), audience)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        ranking.show(folder.tried)
    for sentence in ranking.notes:
        audience.say(sentence)
    audience.say(f"wrote {folder.tried}; nothing was imported")


def _driven(files: Sequence[Path], out: Path, arms: ArmsRecording, audience: Audience) -> bool:
    """Import recordings of real arms; return False if they are none."""
    require("record")
    if not is_driven(files, arms):
        return False
    require("robots")
    imported = import_driven(files, out, arms)
    for sentence in imported.notes:
        audience.say(sentence, warning=True)
    if imported.lag_ms is not None:
        audience.say(f"the arms followed the plan {imported.lag_ms:.2f} ms late")
    how = ", estimated from the images" if arms.estimate_latency else ""
    audience.say(f"images are stamped {imported.latency_ms:.2f} ms after their exposures{how}")
    audience.say(f"{counted(imported.views, 'view')} imported to {out}")
    return True


def _recorded(files: Sequence[Path], out: Path, audience: Audience) -> None:
    imported = import_recordings(files, out)
    for problem in imported.contents.problems:
        audience.say(problem, warning=True)
    if imported.missing:
        audience.say(f"missing: {imported.missing_in_words}", warning=True)
    count = len(imported.views)
    audience.say(f"{count} of {count + len(imported.missing)} views imported to {out}")
