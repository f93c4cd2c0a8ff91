"""The command that finds where source and detector really were."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinct.calibration import PosePrior
from twinct.cli.progress import on_terminal, say
from twinct.errors import InputError
from twinct.runs.calibrating import calibrate_beads, calibrate_self


def self_command(
    folder: Path, name: str | None, sigma_mm: float, sigma_deg: float, correlation_views: float
) -> None:
    """Calibrate by the scan itself, and say what was found."""
    for key, value in (("--sigma-mm", sigma_mm), ("--sigma-deg", sigma_deg)):
        if not value > 0:
            raise InputError(f"{key} {value:g}: more than 0 needed")
    if not correlation_views >= 0:
        raise InputError(f"--correlation-views {correlation_views:g}: 0 or more needed")
    prior = PosePrior(sigma_mm, sigma_deg, correlation_views)
    with on_terminal() as audience:
        found = calibrate_self(folder, prior, name=name or "self", observers=audience)
    source, panel = (
        float(np.sqrt((found.change[:, part] ** 2).sum(axis=1).mean()))
        for part in (slice(0, 3), slice(3, 6))
    )
    say(
        f"{name or 'self'}: {len(found.change)} views moved, source by {source:.3f} mm, panel by "
        f"{panel:.3f} mm (RMS); residuals {found.residuals[0]:.4g}, in the last round "
        f"{found.residuals[-1]:.4g}"
    )


def beads_command(folder: Path, name: str | None, to: Sequence[Path]) -> None:
    """Calibrate by a phantom of balls, and say how well."""
    with on_terminal() as audience:
        found = calibrate_beads(folder, name=name or "beads", others=to, observers=audience)
    told = [view for view in found.views if view]
    left_out = sum(int(view.outliers.sum()) for view in told)
    say(
        f"{name or 'beads'}: {len(told)} of {len(found.views)} views, "
        f"{np.median([len(view.shadows) for view in told]):.0f} balls in the middle one, "
        f"reprojection error {np.median([view.rms_px for view in told]):.3f} px (median), "
        f"{left_out} outliers"
    )
    for view, problem in sorted(found.problems.items()):
        say(f"view {view} stays as it was believed: {problem}", warning=True)
