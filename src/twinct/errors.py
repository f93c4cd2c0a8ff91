"""The errors twinct raises on purpose.

Each names the value, what is allowed and where it came from. ``exit_code`` is what the command line
ends with: 2 for input that a user can mend, 1 for anything else.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class TwinctError(Exception):
    """Base of all errors twinct raises on purpose."""

    exit_code = 1


class InputError(TwinctError):
    """Input that cannot be worked with.

    Attributes:
        problems: one sentence per problem, each understandable alone.
    """

    exit_code = 2

    def __init__(self, problems: str | Iterable[str]) -> None:
        """Keep every problem, so that a user mends all of them at once."""
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        super().__init__("\n".join(self.problems))


class ScenarioError(InputError):
    """A scenario file, or an override of one of its keys, is wrong."""


class SpecimenError(InputError):
    """A specimen that cannot be imaged: an open mesh, no material, nothing in it."""


class TrajectoryError(InputError):
    """Views that an arm cannot reach, or that would collide."""


class NoWayError(TrajectoryError):
    """No way from one view to the next was found, though both can be had."""


class CalibrationError(InputError):
    """A view, or a scan, that does not tell where source and panel were."""


class ScanExistsError(InputError):
    """The output folder already holds a scan, or one of another scenario."""


class DamagedError(InputError):
    """Files of a scan store are not what was written there.

    Attributes:
        found: which, each a ``twinct.scan.manifest.Damage``.
    """

    def __init__(self, problems: Iterable[str], found: Iterable[Any]) -> None:
        """Tell all of them."""
        super().__init__(problems)
        self.found = tuple(found)


class FolderInUseError(InputError):
    """Another process works in the output folder."""


class MissingExtraError(InputError):
    """A part of twinct was asked for whose optional dependency is not installed."""

    def __init__(self, package: str, extra: str, advice: str = "") -> None:
        """Name the package that is missing and the extra that brings it."""
        tail = f"; {advice}" if advice else ""
        super().__init__(
            f"{package} is not installed: it comes with twinct[{extra}], "
            f"'pip install .[{extra}]' in the folder of twinct's sources{tail}"
        )
        self.package = package
        self.extra = extra


class StorageError(InputError):
    """The output cannot be written: no space, no permission."""


class MemoryShortageError(InputError):
    """A job that does not fit into the memory that this process may use."""


class MotionError(TwinctError):
    """The simulated arms did not do what was asked of them.

    Attributes:
        arms: ``source`` and ``detector``, as far as they are the cause.
    """

    def __init__(self, message: str, arms: Iterable[str] = ()) -> None:
        """Say what happened, and to which arms."""
        super().__init__(message)
        self.arms = tuple(arms)


class TargetRefusedError(MotionError):
    """A robot simulation refused a target; the message says view, arm and reason."""


class LinkError(TwinctError):
    """The link between the simulations broke: a process died or did not answer."""
