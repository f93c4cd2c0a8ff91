"""The call that calibrates a scan, by one of five methods."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from twinct.calibration.arm_calibration import Kinematics
from twinct.calibration.circle_calibration import Circle
from twinct.calibration.scan_calibration import Balls, Beads, OwnProjections
from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.observers import Audience, Observers, audience_of
from twinct.runs.folder import Folder
from twinct.scan import free_geometry_name


class Method(Protocol):
    """Settings of a calibration, and how it is made."""

    def run(self, folder: Folder, name: str, audience: Audience, /) -> Any:
        """Estimate the executed geometry of a scan, store it by a name, and describe it."""
        ...


METHODS: Mapping[str, type[Method]] = {
    "beads": Beads,
    "balls": Balls,
    "self": OwnProjections,
    "circle": Circle,
    "kinematics": Kinematics,
}
"""All methods, by the names of their commands and of the geometries that they make."""


@kinds_checked
def calibrate(
    path: str | Path, method: Method | str, *, name: str | None = None, observers: Observers = ()
) -> Any:
    """Estimate the executed geometry of a scan, and store it beside the believed one.

    Args:
        path: folder of a run, or of an imported scan.
        method: an object of ``METHODS``, such as ``OwnProjections(start="epipolar")``, or its name,
            for default settings.
        name: name of the geometry; None: that of the method.
        observers: notified of the progress and of the result, in words.

    Returns:
        the result of the method.

    Raises:
        InputError: an unknown method, a reserved name, or no scan that it can use; nothing is
            written.
        CalibrationError: the images do not determine the geometry.
        ScanExistsError: another geometry has this name; nothing is written.
    """
    if isinstance(method, str):
        if method not in METHODS:
            raise InputError(f"{quoted(method)}: choose a method from {', '.join(METHODS)}")
        method = METHODS[method]()
    name = name or next((key for key, kind in METHODS.items() if isinstance(method, kind)), None)
    if name is None:
        raise InputError(f"name: {type(method).__name__} is no method of twinct: name its geometry")
    free_geometry_name(name)
    with audience_of(observers) as audience:
        return method.run(Folder(Path(path)), name, audience)
