"""A stand-in for the driver of an arm: an action server that follows a plan with a lag and noise.

All that it says of a motion is computed when the goal comes, with stamps as of a real motion, and
sent at once: no test waits for an arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Event, Thread
from typing import Any

import numpy as np
import scipy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String
from waiting import HANG_S

from twinct.link.arm_types import follow_joint_trajectory
from twinct.link.participant import Station

NANO = 1_000_000_000
HALF = ("abort", "silent", "stubborn")
"""They stop half-way; a stubborn one goes on after a stop."""

LAG_S, RATE_HZ, NOISE_DEG = 0.008, 500, 0.001


class StandIn:
    """Driver of an arm in a thread of its own.

    Attributes:
        goals: goals that came.
        cancelled: set when a goal was told to stop.
        true_at: joints at given times since the start of the last goal, (times, joints).
    """

    def __init__(
        self,
        domain: int,
        action: str,
        joints: Sequence[str],
        home: Sequence[float],
        *,
        does: str = "follow",
        lag_s: float = LAG_S,
        noise_deg: float = 0.0,
        topic: str = "/joint_states",
        images: tuple[str, Callable[[], list[tuple[float, np.ndarray]]]] | None = None,
        description: str | None = None,
        clock: Callable[[float], float] = float,
        seed: int = 1,
    ) -> None:
        self.joints, self.home, self.does = list(joints), list(home), does
        self._clock = clock  # of the stamps, by the true time
        self.lag_s, self.noise = lag_s, np.radians(noise_deg)
        self.goals: list[Any] = []
        self.cancelled = Event()
        self._random, self._images = np.random.default_rng(seed), images
        self._action = follow_joint_trajectory()
        self._station = Station(f"driver_{seed}", domain)
        node = self._station._node
        qos = QoSProfile(
            depth=100_000,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        self._told = node.create_publisher(JointState, topic, qos)
        self._shown = None if images is None else node.create_publisher(Image, images[0], qos)
        if description is not None:
            self._described = node.create_publisher(String, "/robot_description", qos)
            self._described.publish(String(data=description))
        self._server = ActionServer(
            node,
            self._action,
            action,
            self._execute,
            goal_callback=self._decide,
            cancel_callback=self._cancel,
        )
        self._idle, self._since = 0, 0.0
        self._timer = node.create_timer(0.02, self._rest)
        self._held: list[Future] = []
        self._ending = Event()
        self._thread = Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        self._station.wait(self._ending.is_set, HANG_S)
        self._station.close()

    def close(self) -> None:
        self._ending.set()
        self._station.wake()
        self._thread.join()

    def _say(self, time_s: float, position: Sequence[float]) -> None:
        message = JointState(name=self.joints, position=list(map(float, position)))
        sec, nanosec = divmod(round(self._clock(time_s) * NANO), NANO)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
        self._told.publish(message)

    def _rest(self) -> None:
        self._idle += 1
        self._say(self._since + self._idle / RATE_HZ, self.home)

    def _decide(self, request: Any) -> GoalResponse:
        self.goals.append(request)
        return GoalResponse.REJECT if self.does == "reject" else GoalResponse.ACCEPT

    def _cancel(self, handle: Any) -> CancelResponse:
        del handle
        self.cancelled.set()
        if self.does == "stubborn":
            return CancelResponse.REJECT
        for held in self._held:
            held.set_result(None)
        return CancelResponse.ACCEPT

    async def _execute(self, handle: Any) -> Any:
        self._timer.cancel()
        trajectory = handle.request.trajectory
        times = np.array(
            [p.time_from_start.sec + p.time_from_start.nanosec / NANO for p in trajectory.points]
        )
        state = np.array([(p.positions, p.velocities, p.accelerations) for p in trajectory.points])
        path = scipy.interpolate.BPoly.from_derivatives(times, state)
        self.true_at = lambda t: path(np.clip(np.asarray(t) - self.lag_s, 0, times[-1]))
        begin = trajectory.header.stamp.sec + trajectory.header.stamp.nanosec / NANO
        end = times[-1] * (0.5 if self.does in HALF else 1) + 0.2
        ticks = np.arange(-0.2, end, 1 / RATE_HZ)
        readings = self.true_at(ticks)
        readings += self._random.normal(0, self.noise, readings.shape)
        for tick, reading in zip(ticks.tolist(), readings.tolist(), strict=True):
            self._say((begin or 1000) + tick, reading)
        if self._images is not None and self._shown is not None:
            for since_s, pixels in self._images[1]():
                self._shown.publish(_image((begin or 1000) + since_s, pixels))
        self._since, self.home = (begin or 1000) + end, self.true_at(end).tolist()
        self._timer.reset()
        if self.does in ("silent", "stubborn"):
            held = Future(executor=self._station._executor)
            self._held.append(held)
            await held
            handle.canceled()
            return self._action.Result()
        if self.does == "abort":
            handle.abort()
            return self._action.Result(error_code=-4, error_string="elbow is 0.3 rad off")
        handle.succeed()
        return self._action.Result()


def _image(time_s: float, pixels: np.ndarray) -> Image:
    sec, nanosec = divmod(round(time_s * NANO), NANO)
    rows, columns = pixels.shape
    message = Image(height=rows, width=columns, encoding="mono16", step=2 * columns)
    message.data = pixels.astype("<u2").tobytes()
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message
