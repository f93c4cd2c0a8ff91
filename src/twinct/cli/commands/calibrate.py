"""``twinct calibrate``: the executed poses of source and detector, by one of five methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from twinct.calibration.calibrate import METHODS, Method
from twinct.calibration.calibrate import calibrate as calibrated
from twinct.calibration.freedom import PosePrior
from twinct.cli.optional import mark_optional
from twinct.cli.progress import on_terminal

FOLDERS = {
    "beads": "Folder of twinct run --out, of a specimen with a ball_helix.",
    "kinematics": "Folder of twinct run --out, of a specimen with a ball_helix.",
    "circle": "Folder of twinct import --out or twinct run --out.",
}
FACTS = {
    "to": tyro.conf.arg(metavar="DIR"),
    "arms": tyro.conf.arg(name="from", metavar="FILE"),
}

calibrate = tyro.extras.SubcommandApp()


def _command(own: str, kind: type[Method]) -> Any:
    """Return the command of a method, whose options are the method's settings."""
    default = kind()

    def command(folder: Path, *, method: Method = default, as_: str = own) -> None:
        with on_terminal() as audience:
            calibrated(folder, method, name=as_, observers=audience)

    where = FOLDERS.get(own, "Folder of twinct run --out.")
    name = tyro.conf.arg(name="as", metavar="NAME", help="Name of the new geometry.")
    command.__annotations__ = {
        "folder": Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR", help=where)],
        "method": Annotated[kind, tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff],
        "as_": Annotated[str, name],
    }
    command.__doc__ = (kind.__doc__ or "").partition("\n")[0]
    return command


mark_optional(PosePrior)
for _kind in METHODS.values():
    mark_optional(_kind, facts=FACTS)
BY_METHOD = {name: _command(name, kind) for name, kind in METHODS.items()}
for _name, _function in BY_METHOD.items():
    calibrate.command(name=_name)(_function)
