"""All formats of programs by name, built in or from extensions."""

from __future__ import annotations

from functools import cache

from twinct.core.extensions import Registry
from twinct.robots.programs.joint_table import JOINT_TABLE
from twinct.robots.programs.language import Language
from twinct.robots.programs.ros_trajectory import ROS_TRAJECTORY
from twinct.robots.programs.urscript import URSCRIPT

BUILT_IN = {language.name: language for language in (ROS_TRAJECTORY, JOINT_TABLE, URSCRIPT)}


@cache
def languages() -> Registry[Language]:
    """Return all formats of programs; they are looked up once per process."""
    return Registry("twinct.programs", Language, BUILT_IN)


def language_named(name: str) -> Language:
    """Return a format by its name.

    Raises:
        InputError: no format has this name, or the package that offers it is broken.
    """
    return languages().named(name, "--to")
