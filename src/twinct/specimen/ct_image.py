"""CT volumes in patient axes, and the conditions under which numbers are Hounsfield units.

Patient axes are RAS as in NIfTI, mm: x towards the patient's right, y anterior, z superior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.geometry import Floats
from twinct.specimen import sections

AIR_HU = -1000.0

RAS_FROM_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Change from the axes of DICOM and ITK: left, posterior, superior."""

HIGHEST_FLOOR_HU = -100.0
"""Highest HU that may be the lowest one of a number type; fat and air lie below."""

STATE_HU = "if they follow from HU by a line, state it: hu: {slope: ..., intercept: ...}"
"""Advice for numbers that are no HU."""


@dataclass(frozen=True, eq=False)
class CtImage:
    """CT volume: values in HU, axes in the file's order; ``affine`` maps indices to RAS, mm."""

    values: NDArray[np.float32]
    affine: Floats

    @property
    def voxel_mm(self) -> Floats:
        """Voxel edges along the three index axes, mm."""
        return np.linalg.norm(self.affine[:3, :3], axis=0)


def in_hu(values: NDArray[np.float32], line: sections.HuLine | None) -> NDArray[np.float32]:
    """Return a file's values in HU, by the line that the part states, if any."""
    if line is None:
        return values
    return values * np.float32(line.slope) + np.float32(line.intercept)


def require_slope(slope: float, where: str) -> None:
    """Raise an error if a file's own line to HU falls.

    Raises:
        SpecimenError: the slope is not positive.
    """
    if not slope > 0:
        raise SpecimenError(
            f"{where}: its values fall where the attenuation rises (slope {slope:g}), so that they "
            f"are no HU; {STATE_HU}"
        )


def require_low_values(kind: str, slope: float, intercept: float, where: str) -> None:
    """Raise an error if the numbers of a file cannot express air and fat.

    Args:
        kind: numpy's kind of the stored numbers; ``u`` for unsigned ones.
        slope: slope of the file's line to HU.
        intercept: its intercept.
        where: beginning of the message.

    Raises:
        SpecimenError: the lowest HU that the stored numbers can express is too high.
    """
    if kind == "u" and slope > 0 and intercept > HIGHEST_FLOOR_HU:
        raise SpecimenError(
            f"{where}: its values are unsigned and start at {intercept:g}, so that they are no HU "
            f"(air has {AIR_HU:g}); {STATE_HU}"
        )
