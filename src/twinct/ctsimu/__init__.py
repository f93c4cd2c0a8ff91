"""CTSimU: scenarios of BAM's open format, rendered and exported, and its qualification suite."""

from twinct.ctsimu.outputs import Options
from twinct.ctsimu.render import render
from twinct.ctsimu.scenario import CtsimuScenario, load_ctsimu

__all__ = ["CtsimuScenario", "Options", "load_ctsimu", "render"]
