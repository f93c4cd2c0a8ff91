"""An arm with six hinges, in a file beside this one."""

from pathlib import Path

from twinct.robots.arm_files import ArmFile

SIX = ArmFile("six", Path(__file__).with_name("six.xml"), {"joint_speed_deg_s": 120.0})
