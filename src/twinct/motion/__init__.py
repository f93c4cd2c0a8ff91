"""How the arms get from view to view: inverse kinematics, planning, and the dynamic simulation.

MuJoCo, mink and Ruckig are imported when they are used, not when this package is.
"""

from twinct.motion.kinematics import IkResult, Kinematics
from twinct.motion.plan import MotionPlan, plan_motion
from twinct.motion.shutter import Shutter
from twinct.motion.simulation import RobotSimulation

__all__ = ["IkResult", "Kinematics", "MotionPlan", "RobotSimulation", "Shutter", "plan_motion"]
