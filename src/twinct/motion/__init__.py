"""How the arms get from view to view: inverse kinematics, planning, and the dynamic simulation.

MuJoCo, mink and Ruckig are imported when they are used, not when this package is.
"""

from twinct.motion.kinematics import IkResult, Kinematics
from twinct.motion.plan import MotionPlan, plan_motion
from twinct.motion.plan_check import Asked, checked_plan
from twinct.motion.plan_file import load_plan, plan_arrays, plan_of_arrays, save_plan
from twinct.motion.roll import roll_free
from twinct.motion.shutter import Shutter
from twinct.motion.simulation import RobotSimulation
from twinct.motion.timing import TimeLaw
from twinct.motion.way import Way, find_way

__all__ = [
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
    "plan_arrays",
    "plan_motion",
    "plan_of_arrays",
    "roll_free",
    "save_plan",
]
