"""How the arms get from view to view: inverse kinematics, planning, and the dynamic simulation.

MuJoCo, mink and Ruckig are imported when they are used, not when this package is.
"""

from twinct.motion.kinematics import IkResult, Kinematics
from twinct.motion.plan import MotionPlan, plan_motion
from twinct.motion.roll import roll_free
from twinct.motion.shutter import Shutter
from twinct.motion.simulation import RobotSimulation
from twinct.motion.timing import TimeLaw
from twinct.motion.way import Way, find_way

__all__ = [
    "IkResult",
    "Kinematics",
    "MotionPlan",
    "RobotSimulation",
    "Shutter",
    "TimeLaw",
    "Way",
    "find_way",
    "plan_motion",
    "roll_free",
]
