"""Motion of the arms from view to view: inverse kinematics, planning and dynamic simulation.

MuJoCo, mink and Ruckig are imported on first use, not together with this package.
"""

from twinct.robots.motion.gate import Gate, gate_of
from twinct.robots.motion.joint_goal import GoalError, JointGoal, goal_of
from twinct.robots.motion.kinematics import IkResult, Kinematics
from twinct.robots.motion.layers import speeds_of
from twinct.robots.motion.limits import limiting
from twinct.robots.motion.path_search import JointPath, find_joint_path
from twinct.robots.motion.plan import MotionPlan, plan_motion
from twinct.robots.motion.plan_check import RequestedViews, checked_plan
from twinct.robots.motion.plan_file import (
    LARGEST_PLAN_BYTES,
    load_plan,
    plan_arrays,
    plan_of_arrays,
    save_plan,
)
from twinct.robots.motion.pursuit import PursuingSimulation
from twinct.robots.motion.roll import roll_free
from twinct.robots.motion.shutter import Shutter
from twinct.robots.motion.simulation import RobotSimulation
from twinct.robots.motion.timing import TimeLaw
from twinct.robots.motion.tour import moving_seconds, shortest_tour

__all__ = [
    "LARGEST_PLAN_BYTES",
    "RequestedViews",
    "Gate",
    "GoalError",
    "IkResult",
    "Kinematics",
    "MotionPlan",
    "RobotSimulation",
    "Shutter",
    "TimeLaw",
    "JointGoal",
    "JointPath",
    "PursuingSimulation",
    "checked_plan",
    "find_joint_path",
    "gate_of",
    "goal_of",
    "load_plan",
    "moving_seconds",
    "plan_arrays",
    "limiting",
    "plan_motion",
    "plan_of_arrays",
    "roll_free",
    "save_plan",
    "shortest_tour",
    "speeds_of",
]
