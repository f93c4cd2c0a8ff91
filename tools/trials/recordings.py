"""Recordings of drives, by what does not depend on the time."""

from typing import Any


def told_by(file):
    """Return plan, scenario, names and end of a recording, each if it is there.

    A part of a file is read up to its cut. ``topics`` are those of messages; ``sent`` is True if
    the plan was sent. What no reader takes for a recording is returned as its error.
    """
    from mcap.records import Attachment

    from twinct.core.errors import InputError
    from twinct.link.recording.drive_file import NOTE, OUTCOME
    from twinct.link.recording.reader import RecordedMessage, Recording

    told: dict[str, Any] = {"topics": []}
    if not file.stat().st_size:  # killed before the first byte
        return told
    try:
        for record in Recording(file).records():
            if isinstance(record, RecordedMessage):
                told["topics"] = sorted({*told["topics"], record.topic})
            elif isinstance(record, Attachment):
                told[record.name] = record.data
            elif record.name == NOTE:
                told["names"] = record.metadata
            elif record.name == OUTCOME:
                told["ended"] = record.metadata["ended"]
                told["sent"] = "start_ns" in record.metadata
    except InputError as error:
        told["error"] = str(error)
    return told


def is_part(told, whole):
    """Return True if a recording is a part of a whole one, and says no other end than it had."""
    facts = {name: value for name, value in told.items() if name not in ("topics", "ended", "sent")}
    return (
        {*told["topics"]} <= {*whole["topics"]}
        and all(whole.get(name) == value for name, value in facts.items())
        and told.get("ended") != whole["ended"]
    )
