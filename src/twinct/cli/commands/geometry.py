"""``twinct geometry``: geometries of a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Overrides
from twinct.cli.progress import on_terminal
from twinct.core.errors import InputError
from twinct.evaluation import pose_errors
from twinct.runs import derive_geometry, load_scan


def geometry(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    set_: Overrides = (),
) -> None:
    """List the geometries of a scan, or derive a new one: poses that its robots would report.

    Args:
        folder: Folder of twinct run --out.
        as_: Name of the new geometry; without it, existing geometries are listed.
        set_: Keys of uncertainty, such as --set uncertainty.seed=3.
    """
    if as_ is not None:
        with on_terminal() as audience:
            derive_geometry(folder, as_, set_, audience)
    elif set_:
        raise InputError(f"--set {set_[0]}: a new geometry needs a name (--as)")
    scan = load_scan(folder)
    taken = scan.provenance.kept
    table = Table("geometry", f"source to {taken}, mm", f"detector to {taken}, mm", "made by")
    for name in scan.geometries:
        errors = pose_errors(scan.poses(taken), scan.poses(name))
        means = (f"{arm.position_mm.mean():.4f}" for arm in (errors.source, errors.detector))
        made_by = scan.derived[name].made_by if name in scan.derived else {}
        words = ", ".join(f"{k} {v}" for k, v in made_by.items() if not isinstance(v, dict))
        table.add_row(name, *means, words)
    Console().print(table)
