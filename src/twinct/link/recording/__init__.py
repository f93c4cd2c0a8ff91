"""Recording of a scan as ROS 2 messages in an MCAP file, and recovery of the scan from such files.

Importing this package needs no MCAP library; using its members does.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from twinct.core.extras import require

if TYPE_CHECKING:
    from twinct.link.recording.recorder import Recorder
    from twinct.link.recording.recovery import ForeignScan, RecoveredScan, read_recordings

__all__ = [
    "ForeignScan",
    "RecoveredScan",
    "Recorder",
    "read_recordings",
    "recorder_of",
    "recordings",
]

_HOMES = {
    "ForeignScan": "recovery",
    "RecoveredScan": "recovery",
    "Recorder": "recorder",
    "read_recordings": "recovery",
}


def recordings(folder: Path) -> list[Path]:
    """Return all recordings of a run, in the order in which they were made."""
    return sorted(folder.glob("scan*.mcap"), key=lambda path: (len(path.name), path.name))


def recorder_of(link: Literal["ros2", "local"], folder: Path) -> Recorder:
    """Return a recorder of a link's scan, which writes to a folder.

    Raises:
        MissingExtraError: the extra ``record`` is not installed.
    """
    require("record")
    if link == "local":
        from twinct.link.recording.local import LocalRecorder

        return LocalRecorder(folder)
    from twinct.link.recording.graph import GraphRecorder

    return GraphRecorder(folder)


def __getattr__(name: str) -> Any:
    """Import members that need the MCAP library only on request.

    Raises:
        MissingExtraError: the MCAP library is not installed.
    """
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require("record")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
