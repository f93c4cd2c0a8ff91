"""``twinct ctsimu``: scenarios of the CTSimU format, in and out, and the suite that judges us."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

ctsimu = tyro.extras.SubcommandApp()

_Flag = tyro.conf.FlagCreatePairsOff[bool]


@ctsimu.command
def render(
    scenario: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE.json")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    samples: int = 3,
    spot_points: int = 30,
    seed: int = 0,
    resume: _Flag = False,
) -> None:
    """Render a CTSimU scenario: TIFF projections, dark and flat images, metadata.

    Writes NAME_0000.tif ..., NAME_dark.tif, NAME_flat.tif and NAME_metadata.json into DIR.

    Args:
        scenario: CTSimU scenario, file format 1.0 to 1.2.
        out: Folder for the images; what is there is never touched without --resume.
        samples: Rays along each pixel edge, for a point source; the time grows with its square.
        spot_points: Points that a focal spot with extent is sampled by; the time grows with it.
        seed: Seed of the noise.
        resume: Go on with a rendering that was interrupted.
    """
    from twinct.cli.progress import TerminalProgress
    from twinct.ctsimu import Options, load_ctsimu, render
    from twinct.errors import InputError

    low = [f"--{n} {v}: must be at least 1" for n, v in _counts(samples, spot_points) if v < 1]
    if low:
        raise InputError(low)
    loaded = load_ctsimu(scenario)
    options = Options(samples, spot_points, seed)
    with TerminalProgress().stage("projections", loaded.frames) as step:
        files = render(loaded, out, options, resume=resume, step=step)
    Console().print(f"wrote {files.metadata}", highlight=False)


def _counts(samples: int, spot_points: int) -> list[tuple[str, int]]:
    return [("samples", samples), ("spot-points", spot_points)]
