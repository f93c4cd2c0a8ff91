"""MCAP file of a plan that real controllers followed: the plan, and what their drivers said."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from twinct.core.errors import ScanExistsError
from twinct.core.files.private import temporary_folder
from twinct.core.files.writing import storage_errors
from twinct.link.recording.bag import Bag
from twinct.link.recording.recorder import PLAN, SCENARIO
from twinct.link.topics import JOINTS
from twinct.robots.motion import save_plan
from twinct.scenario import Scenario

if TYPE_CHECKING:  # they need rclpy and MuJoCo; those who read such files do without
    from twinct.link.senders import Raw, Sender
    from twinct.robots.motion import MotionPlan

NOTE, OUTCOME = "twinct drive", "twinct drive outcome"
"""Names of the notes before and after the motion."""

DRIVE_FORMAT = "twinct drive 1"

CHUNK_BYTES = 2**18
"""Size of a chunk, which a killed process may lose: a second of joints of two arms at 500 Hz."""


class DriveFile:
    """The file, which holds every message that came, however the motion ends.

    Attributes:
        path: its path.
        heard: number of messages by topic.
    """

    def __init__(
        self,
        path: Path,
        scenario: Scenario,
        plan: MotionPlan,
        names: Mapping[str, str],
        joint_states: Sequence[str] = (JOINTS.name,),
    ) -> None:
        """Create the file.

        Args:
            path: its path.
            scenario: scenario of the plan.
            plan: the plan.
            names: joint names of the scenario by those of the drivers.
            joint_states: topics of the drivers' joint states.

        Raises:
            ScanExistsError: the file exists.
            StorageError: it cannot be written.
        """
        self.path = path
        self.heard: dict[str, int] = {}
        if os.path.lexists(path):
            raise ScanExistsError(f"{path} exists already: choose another --out")
        with storage_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._bag = Bag(path, CHUNK_BYTES)
            try:
                data = {"joints": dict(names), "joint_states": list(joint_states)}
                facts = {key: json.dumps(value) for key, value in data.items()}
                self._bag.note(NOTE, {"format": DRIVE_FORMAT, **facts})
                self._bag.attach(SCENARIO, scenario.resolved().encode())
                with temporary_folder() as folder:
                    save_plan(plan, folder / PLAN)
                    self._bag.attach(PLAN, (folder / PLAN).read_bytes())
            except BaseException:
                path.unlink(missing_ok=True)
                raise

    def write(self, topic: str, kind: str, raw: Raw, sender: Sender) -> None:
        """Write a message as it came."""
        self.heard[topic] = self.heard.get(topic, 0) + 1
        self._bag.write_raw(topic, kind, raw.data, raw.received_ns, raw.sent_ns, sender.number)
        self._bag.flush()

    def finish(self, **outcome: str) -> None:
        """Write how the motion ended, and complete the file."""
        self._bag.note(OUTCOME, outcome)
        self._bag.close()

    def close(self) -> None:
        """Complete the file; a second call does nothing."""
        self._bag.close()
