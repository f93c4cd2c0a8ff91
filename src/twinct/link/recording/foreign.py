"""Recovery of a scan from other software's recordings of poses, cameras and images."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Panel
from twinct.geometry.wire import PosePairs, Reached
from twinct.link.recording.contents import Contents, checked
from twinct.link.recording.reader import instants_of, seven_of
from twinct.link.stamps import NANO
from twinct.link.topics import CAMERA, IMAGE, JOINTS, REACHED, STATE, TARGET, VIEWS
from twinct.scenario import Scenario, parse_scenario


class Foreign(NamedTuple):
    """Parts of a scan that were recovered.

    Attributes:
        scenario: a gantry that follows the recorded poses of source and panel; the specimen is
            unknown.
        commanded: poses of the views that have an image, ordered by stamp: targets if recorded,
            else executed poses.
        reached: state of the robots in these views, by stamp.
        views: view of each of these stamps.
        missing: indices, among all stamps, of those without an image.
    """

    scenario: Scenario
    commanded: PosePairs
    reached: dict[int, Reached]
    views: dict[int, int]
    missing: tuple[int, ...]


def foreign_scan(contents: Contents, views_file: Path) -> Foreign:
    """Build a scan from the available messages.

    Args:
        contents: content of the recordings.
        views_file: path for the scenario's list of views.

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
    poses: list[PosePairs] = []
    reached: dict[int, Reached] = {}
    for stamp in whole:
        with contents.message_of(stamp):
            instants[stamp] = instant = instants_of(contents.at(REACHED, stamp).poses[:3])
            target = _target(contents, stamp, instant)
            poses.append(target)
            for one in (target, instant):
                one.geometry(Panel(1, 1, 1.0, 1.0))
            reached[stamp] = checked(_reached(contents, stamp, instant))
    return Foreign(
        scenario=_scenario(contents, instants, views_file),
        commanded=PosePairs.joined(poses),
        reached=reached,
        views={stamp: view for view, stamp in enumerate(whole)},
        missing=tuple(n for n, stamp in enumerate(stamps) if stamp not in contents.imaged),
    )


def _target(contents: Contents, stamp: int, instant: PosePairs) -> PosePairs:
    message: Any = None
    if (view := contents.at(VIEWS, stamp)) is not None:
        message = contents.at(TARGET, view.time_ref.sec * NANO + view.time_ref.nanosec)
    if message is None:
        return PosePairs(instant.source, instant.detector)
    return PosePairs.from_sevens([[seven_of(pose) for pose in message.poses[:2]]])


def _reached(contents: Contents, stamp: int, instant: PosePairs) -> Reached:
    state, joints, none = contents.at(STATE, stamp), contents.at(JOINTS, stamp), np.zeros(0)
    numbers = np.array([stamp / NANO, np.nan] if state is None else state.data)
    offset = 0 if state is None else state.layout.data_offset
    return Reached(
        executed=instant,
        joint_names=() if joints is None else tuple(joints.name),
        position=none if joints is None else np.array(joints.position),
        velocity=none if joints is None else np.array(joints.velocity),
        effort=none if joints is None else np.array(joints.effort),
        state=numbers[offset:],
        time_s=float(numbers[0]),
        clearance_mm=float(numbers[1]),
    )


def _scenario(contents: Contents, instants: dict[int, PosePairs], views_file: Path) -> Scenario:
    """Return the scenario, with the pixel pitch computed from the first camera's focal lengths."""
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
    return parse_scenario(
        {
            "name": contents.recordings[0].path.stem,
            "description": f"Imported from {contents.names}. Its specimen is unknown: figures "
            "against the sphere that stands in for it mean nothing.",
            "cell": {"kind": "gantry"},
            "trajectory": {"kind": "file", "path": str(views_file.absolute())},
            "detector": {
                "columns": camera.width,
                "rows": camera.height,
                "pixel_pitch_mm": pitch,
            },
            "specimen": {
                "parts": [
                    {
                        "name": "unknown",
                        "shape": {"kind": "sphere", "radius_mm": 50},
                        "material": "bone",
                    }
                ]
            },
            "uncertainty": {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}},
        }
    )
