"""Search for a run to show, before anything large is imported."""

from __future__ import annotations

from pathlib import Path

from twinct.core.errors import InputError

SCAN, SCENARIO = "scan.zarr", "scenario.yaml"


def folder_of_run(path: Path) -> Path:
    """Return the folder of a run, given the folder of ``twinct run --out`` or its scan.zarr.

    Raises:
        InputError: the path is no folder of a run.
    """
    path = path.parent if path.name == SCAN else path
    if not path.is_dir():
        raise InputError(f"{path}: there is no such folder")
    if not (path / SCAN).is_dir() and not (path / SCENARIO).is_file():
        raise InputError(
            f"{path} is not a run folder: it holds neither {SCAN} nor {SCENARIO}; "
            "'twinct run SCENARIO --out DIR' makes one"
        )
    return path
