"""The rig, which moves to a view and takes its image, whatever links the two simulations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Panel
from twinct.geometry.wire import JointSample, PosePairs, Reached
from twinct.scan.builder import SimulationBuilder

if TYPE_CHECKING:
    from twinct.robots.gantry import Gantry
    from twinct.robots.motion import RobotSimulation
    from twinct.xray import Imager


class Rig(Protocol):
    """Protocol of a rig, which takes one view after the other.

    ``move`` and ``expose`` alternate, with views in ascending order. All rigs of a scenario give
    bit-identical images.
    """

    def move(self, view: int, target: PosePairs) -> Reached:
        """Bring both end-effectors to a target.

        Raises:
            TargetRefusedError: the target is out of reach, would collide, or was not reached.
            LinkError: a simulation is gone.
        """
        ...

    def expose(self, view: int) -> NDArray[np.float32]:
        """Return the transmission I/I0 of the view just reached, (rows, columns).

        Raises:
            LinkError: a simulation is gone.
        """
        ...

    def listen(self, tell: Callable[[JointSample], None]) -> None:
        """Report the joints while they move, at least 50 times per second of simulated time.

        A gantry has no joints to report.
        """
        ...

    def close(self) -> None:
        """Release all resources; a second call does nothing."""
        ...


RigFactory = Callable[[SimulationBuilder, int, NDArray[np.float64] | None], Rig]
"""Factory of rigs from a scenario's parts, first view, and the simulator's state before it."""


class LocalRig:
    """Both simulations in this process.

    Attributes:
        imager: the X-ray simulation; a process has at most one.
    """

    def __init__(self, robots: RobotSimulation | Gantry, imager: Imager, panel: Panel) -> None:
        """Take over both simulations; ``close`` ends them."""
        self._robots, self.imager, self._panel = robots, imager, panel
        self._reached: tuple[int, Reached] | None = None

    def move(self, view: int, target: PosePairs) -> Reached:
        """See ``Rig.move``."""
        self._reached = view, self._robots.move(view, target)
        return self._reached[1]

    def expose(self, view: int) -> NDArray[np.float32]:
        """See ``Rig.expose``."""
        if self._reached is None or self._reached[0] != view:
            raise ValueError(f"view {view} was not reached: move before you expose")
        reached = self._reached[1]
        return self.imager.expose(reached.path, view, reached.before, time_s=reached.stamp_s)

    def listen(self, tell: Callable[[JointSample], None]) -> None:
        """See ``Rig.listen``."""
        self._robots.on_joints = tell

    def close(self) -> None:
        """See ``Rig.close``."""
        self._robots.close()
        self.imager.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def local_rig(
    builder: SimulationBuilder, first_view: int, start_state: NDArray[np.float64] | None
) -> LocalRig:
    """Return a rig with both simulations in this process.

    Args:
        builder: the scenario's parts.
        first_view: not used here.
        start_state: state of the robot simulation at the start; None for the planned home.
    """
    del first_view
    robots = builder.robots()
    if start_state is not None:
        robots.restore(start_state)
    return LocalRig(robots, builder.imager(), builder.scenario.detector.panel)
