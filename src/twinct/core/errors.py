"""Errors that twinct raises on purpose.

Each names the value, the allowed values and the origin. ``exit_code`` is the exit status of the
command line: 2 for input that a user can fix, 1 for anything else. ``core.interruption`` has the
interruptions, which are no errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from twinct.core.foreign_text import stated
from twinct.core.installation import install_command


class TwinctError(Exception):
    """Base of all errors that twinct raises on purpose."""

    exit_code = 1

    @property
    def lines(self) -> list[str]:
        """Lines of the message, below 2,000 characters together."""
        return stated([super().__str__()])

    def __str__(self) -> str:
        return "\n".join(self.lines)


class InputError(TwinctError):
    """Input that cannot be used.

    Attributes:
        problems: one sentence per problem, each understandable alone.
        more: number of further problems, which have no sentence.
    """

    exit_code = 2

    def __init__(self, problems: str | Iterable[str], more: int = 0) -> None:
        """Store every problem; the message states the first ones."""
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        self.more = more
        super().__init__("\n".join(self.problems))

    @property
    def lines(self) -> list[str]:
        """Lines of the message: the first problems, and a count of the others."""
        return stated(self.problems, self.more)


class ScenarioError(InputError):
    """A scenario file, or an override of one of its keys, is wrong."""


class SpecimenError(InputError):
    """A specimen that cannot be imaged: an open mesh, no material, or nothing inside."""


class TrajectoryError(InputError):
    """Views that an arm cannot reach, or that would collide.

    Attributes:
        views: indices of the views that the arms cannot hold, as far as known, in ascending order.
    """

    def __init__(self, problems: str | Iterable[str], views: Iterable[int] = ()) -> None:
        """Store every problem and the views."""
        super().__init__(problems)
        self.views = tuple(sorted(views))


class NoPathError(TrajectoryError):
    """No path was found from one view to the next, although the arms can reach both.

    ``views`` holds the second one of the two.
    """


class CalibrationError(InputError):
    """A view or scan from which the poses of source and panel cannot be determined."""


class ScanExistsError(InputError):
    """The output folder already holds a scan, or one of another scenario."""


class DamagedError(InputError):
    """Files of a scan store differ from the files that were written.

    Attributes:
        damages: the damages, each a ``twinct.scan.manifest.Damage``.
    """

    def __init__(self, problems: Iterable[str], damages: Iterable[Any]) -> None:
        """Store the problems and the damages."""
        super().__init__(problems)
        self.damages = tuple(damages)


class FolderInUseError(InputError):
    """Another process works in the output folder."""


class MissingExtraError(InputError):
    """A requested part of twinct needs an optional dependency that is not installed."""

    def __init__(
        self, package: str | Sequence[str], extra: str | Sequence[str], advice: str = ""
    ) -> None:
        """Name all missing packages, the extras that bring them, and the command for both."""
        packages = [package] if isinstance(package, str) else [*package]
        extras = [extra] if isinstance(extra, str) else [*extra]
        several, wanted = len(packages) > 1, f"twinct[{','.join(extras)}]"
        super().__init__(
            f"{', '.join(packages)} {'are' if several else 'is'} not installed: "
            f"{'they come' if several else 'it comes'} with {wanted}: "
            f"{install_command(extras)}{f'; {advice}' if advice else ''}"
        )
        self.packages = tuple(packages)
        self.extras = tuple(extras)


class DrawingError(InputError):
    """Pictures of the room cannot be drawn on this machine; everything else works."""


class StorageError(InputError):
    """The output cannot be written: no space, no permission."""


class MemoryShortageError(InputError):
    """A job that does not fit into the memory available to this process."""


class MotionError(TwinctError):
    """The simulated arms did not perform a motion.

    Attributes:
        arms: ``source`` and ``detector``, as far as they are the cause.
    """

    def __init__(self, message: str, arms: Iterable[str] = ()) -> None:
        """Store the message and the arms that it concerns."""
        super().__init__(message)
        self.arms = tuple(arms)


class TargetRefusedError(MotionError):
    """A robot simulation refused a target; the message says view, arm and reason."""


class LinkError(TwinctError):
    """The link between the simulations broke: a process died or did not answer."""


class TimeUpError(InputError):
    """The time that a command may take is over."""
