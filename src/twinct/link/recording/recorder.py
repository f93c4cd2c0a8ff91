"""Base of both recorders: the file, its attachments and its metadata."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.files.private import temporary_folder
from twinct.core.files.writing import require_space
from twinct.geometry.wire import PosePairs
from twinct.link.plain import transforms
from twinct.link.recording.bag import Bag
from twinct.link.stamps import Stamp
from twinct.link.topics import IMAGE, KINDS, TF
from twinct.robots.motion import save_plan
from twinct.scan import NamedGeometry, Rig, RigFactory, SimulationBuilder
from twinct.scenario import stage_digests
from twinct.version import __version__

if TYPE_CHECKING:
    from twinct.link.tap import Heard
    from twinct.robots.cell import LinkFrames

FORMAT = "twinct recording 1"

SCENARIO, PLAN, COMMANDED, BELIEVED = "scenario.json", "plan.npz", "commanded.json", "believed.json"
"""Files in a recording; there is no plan if the arms follow none."""


BYTES_A_PIXEL = 5.5
"""Bytes per pixel of an image and its display version, plus a tenth for everything else."""


class Recorder(ABC):
    """Writer of ``scan.mcap`` in a run's folder; a resumed scan writes another file.

    Attributes:
        path: path of the file.
        problems: gaps in the recording, as text for users.
        hear: called with every ROS 2 message; None if ROS is not needed.
    """

    hear: Callable[[Heard], None] | None = None

    def __init__(self, folder: Path) -> None:
        """Prepare a recorder, which writes nothing before ``begin``."""
        self.path = folder / "scan.mcap"
        self.problems: list[str] = []
        self._bag: Bag | None = None
        self._links: LinkFrames | None = None

    def rigs(self, make_rig: RigFactory) -> RigFactory:
        """Return a factory of rigs that are recorded."""

        def make(builder: SimulationBuilder, first: int, state: NDArray[np.float64] | None) -> Rig:
            self.close()  # completes the file of an earlier range of missing views
            self.begin(builder, first)
            return self.around(make_rig(builder, first, state))

        return make

    def begin(self, builder: SimulationBuilder, first: int) -> None:
        """Create the file, and attach scenario, plan and commanded poses.

        Args:
            builder: the scenario's parts.
            first: first view to acquire.

        Raises:
            StorageError: the file cannot be written.
        """
        scenario = builder.scenario
        pixels, folder = scenario.detector.rows * scenario.detector.columns, self.path.parent
        views = len(builder.targets) - first
        require_space(folder, round(views * pixels * BYTES_A_PIXEL), "the recording needs")
        others = (folder / f"scan_{number}.mcap" for number in count(1))
        self.path = next(path for path in chain([self.path], others) if not path.exists())
        self._bag = bag = Bag(self.path, 4 * pixels)
        if scenario.cell.kind == "arms":
            from twinct.robots.cell import LinkFrames

            self._links = LinkFrames(builder.cell)
        bag.note("twinct", _facts(stage_digests(scenario)["images"], len(builder.targets), first))
        bag.attach(SCENARIO, scenario.resolved().encode())
        with temporary_folder() as folder:
            commanded = NamedGeometry("commanded", builder.commanded_poses, {})
            bag.attach(COMMANDED, commanded.write(folder).read_bytes())
            if plan := builder.followed:
                save_plan(plan, folder / PLAN)
                bag.attach(PLAN, (folder / PLAN).read_bytes())

    @abstractmethod
    def around(self, rig: Rig) -> Rig:
        """Wrap a rig, so that each view is recorded before it is stored."""

    def write(self, topic: str, message: Mapping[str, Any], time_ns: int) -> None:
        """Encode and write a message."""
        assert self._bag is not None
        self._bag.write(topic, KINDS[topic], message, time_ns)
        if topic == IMAGE:
            self._bag.flush()

    def write_frames(
        self, stamp: Stamp, instant: PosePairs, joints: ArrayLike, time_ns: int
    ) -> None:
        """Write ``/tf`` of a view."""
        links = self._links.at(joints) if self._links else None
        self.write(TF, transforms(stamp, instant, links), time_ns)

    def finish(self, believed: NamedGeometry) -> None:
        """Attach the believed poses, and complete the file."""
        if self._bag is None:
            self.problems.append("no view was taken, so nothing was recorded")
        else:
            with temporary_folder() as folder:
                self._bag.attach(BELIEVED, believed.write(folder).read_bytes())
            self.close()

    def close(self) -> None:
        """Complete the file in any case; a second call does nothing."""
        if self._bag is not None:
            self._bag.close()


def _facts(digest: str, views: int, first: int) -> dict[str, str]:
    return {
        **{"format": FORMAT, "version": __version__, "images": digest},
        **{"views": str(views), "first": str(first)},
    }
