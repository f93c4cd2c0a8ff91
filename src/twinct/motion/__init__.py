"""Motion of the arms from view to view: inverse kinematics, planning and dynamic simulation.

MuJoCo, mink and Ruckig are imported on first use, not together with this package.
"""

from twinct.motion.kinematics import IkResult, Kinematics
from twinct.motion.layers import speeds_of
from twinct.motion.plan import MotionPlan, plan_motion
from twinct.motion.plan_check import Asked, checked_plan
from twinct.motion.plan_file import (
    LARGEST_PLAN_BYTES,
    load_plan,
    plan_arrays,
    plan_of_arrays,
    save_plan,
)
from twinct.motion.roll import roll_free
from twinct.motion.shutter import Shutter
from twinct.motion.simulation import RobotSimulation
from twinct.motion.timing import TimeLaw
from twinct.motion.tour import moving_seconds, shortest_tour
from twinct.motion.way import Way, find_way

__all__ = [
    "LARGEST_PLAN_BYTES",
    "Asked",
    "IkResult",
    "Kinematics",
    "MotionPlan",
    "RobotSimulation",
    "Shutter",
    "TimeLaw",
    "Way",
    "checked_plan",
    "find_way",
    "load_plan",
    "moving_seconds",
    "plan_arrays",
    "plan_motion",
    "plan_of_arrays",
    "roll_free",
    "save_plan",
    "shortest_tour",
    "speeds_of",
]
