"""Recovery of a scan from other software's recordings of poses, cameras and images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from twinct.core.errors import InputError
from twinct.geometry import Panel
from twinct.geometry.wire import PosePairs
from twinct.link.recording.contents import Contents
from twinct.link.recording.reader import instants_of, seven_of
from twinct.link.stamps import NANO
from twinct.link.topics import CAMERA, IMAGE, REACHED, TARGET, VIEWS
from twinct.recon.field_of_view import grid_of
from twinct.scan import Imported, NamedGeometry
from twinct.scenario.imported import load_imported

TARGETS = "targets"
"""Name of the geometry that a recording's targets make."""


class Foreign(NamedTuple):
    """Parts of a scan that were recovered.

    Attributes:
        provenance: panel, reconstruction, and the poses that ``REACHED`` states.
        targets: the poses that were asked for; None if the recording does not relate them to views.
        views: view of each complete stamp.
        missing: indices, among all stamps, of those without an image.
    """

    provenance: Imported
    targets: NamedGeometry | None
    views: dict[int, int]
    missing: tuple[int, ...]


def foreign_scan(contents: Contents) -> Foreign:
    """Build a scan from the available messages.

    Raises:
        InputError: poses, cameras or images are missing or invalid.
    """
    needed = {topic: contents.said[topic] for topic in (REACHED, CAMERA)} | {IMAGE: contents.imaged}
    if lacking := [topic for topic, stamps in needed.items() if not stamps]:
        there = ", ".join(sorted(contents.topics)) or "none"
        raise InputError(
            f"{contents.names}: not recorded by twinct, and nothing can be imported without "
            f"{', '.join(lacking)}; topics found: {there}"
        )
    stamps = sorted(contents.said[REACHED])
    whole = [stamp for stamp in stamps if stamp in contents.imaged]
    instants: dict[int, PosePairs] = {}
    targets: list[PosePairs] = []
    for stamp in whole:
        with contents.message_of(stamp):
            instant = instants_of(contents.at(REACHED, stamp).poses[:3])
            target = _target(contents, stamp)
            for one in (target, instant):
                if one is not None:
                    one.geometry(Panel(1, 1, 1.0, 1.0))  # checks it
            instants[stamp] = PosePairs(instant.source, instant.detector)
            if target is not None:
                targets.append(target)
    missing = tuple(n for n, stamp in enumerate(stamps) if stamp not in contents.imaged)
    views = {stamp: view for view, stamp in enumerate(whole)}
    if not views:
        problems = ("no view is complete, so there is nothing to import", *contents.problems)
        raise InputError(f"{contents.names}: {'; '.join(problems)}")
    taken = _provenance(contents, instants)
    asked = None
    if len(targets) == len(whole):
        made_by = {"model": "recorded targets", **taken.made_for}
        asked = NamedGeometry(TARGETS, PosePairs.joined(targets), made_by)
    return Foreign(taken, asked, views, missing)


def _target(contents: Contents, stamp: int) -> PosePairs | None:
    """Return the poses that a view was asked for; None if no message says so."""
    if (view := contents.at(VIEWS, stamp)) is None:
        return None
    message: Any = contents.at(TARGET, view.time_ref.sec * NANO + view.time_ref.nanosec)
    if message is None:
        return None
    return PosePairs.from_sevens([[seven_of(pose) for pose in message.poses[:2]]])


def _provenance(contents: Contents, instants: Mapping[int, PosePairs]) -> Imported:
    """Return what is known; the pixel pitch follows from the first camera's focal lengths."""
    stamp = next((s for s in contents.said[CAMERA] if s in instants), None)
    if stamp is None:
        raise InputError(
            f"{contents.names}: no message on {CAMERA} has the stamp of one on {REACHED}"
        )
    camera = contents.at(CAMERA, stamp)
    with contents.message_of(stamp):
        geometry = instants[stamp].geometry(Panel(camera.height, camera.width, 1.0, 1.0))
        sdd = float(geometry.sdd[0])
        pitch = [round(sdd / abs(float(focal)), 9) for focal in (camera.k[0], camera.k[4])]
        panel = Panel(camera.height, camera.width, *pitch)
    stated = PosePairs.joined(instants.values())
    settings = load_imported(
        {
            "name": contents.recordings[0].path.stem,
            "description": f"Imported from {contents.names}. The object is not known.",
            "detector": {
                "columns": camera.width,
                "rows": camera.height,
                "pixel_pitch_mm": pitch,
            },
            "reconstruction": {"algorithm": "fast", "grid": grid_of(stated.geometry(panel))},
        }
    )
    files = tuple(one.path.name for one in contents.recordings)
    return Imported(settings, stated, files)
