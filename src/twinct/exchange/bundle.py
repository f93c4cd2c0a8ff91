"""A folder with all data that another toolkit needs for a reconstruction, and a loading script."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.errors import ScanExistsError
from twinct.core.files.writing import complete
from twinct.exchange.format import Bundle, Format
from twinct.exchange.formats import FormatName, format_named
from twinct.geometry import ScanGeometry

_MEANING = {
    "line-integrals": "line integrals -ln(I/I0), mm times 1/mm",
    "transmission": "transmission I/I0",
}
_COMMON = {
    "export.json": "sizes, and where the volume is in the world",
    "load.py": "loads all of it",
}


def bundle_bytes(geometry: ScanGeometry) -> int:
    """Return an upper limit of a bundle's size on disk, bytes."""
    return len(geometry) * (int(np.prod(geometry.panel.shape)) * 4 + 4096) + 2**20


def write_bundle(folder: Path, to: FormatName, bundle: Bundle) -> None:
    """Write a bundle; the folder appears under its name only when it is complete.

    Args:
        folder: the folder.
        to: name of a format; see ``formats``.
        bundle: the scan.

    Raises:
        ScanExistsError: the folder exists; it is not changed.
        InputError: there is no such format, or it does not support the grid or a view; nothing is
            written.
        OSError: the disk is full or not writable; nothing is left behind.
    """
    form = format_named(to)
    if folder.exists():
        raise ScanExistsError(f"{folder} already exists: choose another --out")
    form.check(bundle)
    if not folder.parent.exists():
        folder.parent.mkdir(parents=True)
    with complete(folder) as draft:
        draft.mkdir()
        form.write(bundle, draft)
        (draft / "export.json").write_text(json.dumps(_facts(bundle), indent=2) + "\n")
        (draft / "load.py").write_text(form.script, encoding="utf-8")
        (draft / "README.txt").write_text(_readme(form, bundle), encoding="utf-8")


def _facts(bundle: Bundle) -> dict[str, Any]:
    grid, panel = bundle.grid, bundle.geometry.panel
    return {
        **bundle.origin,
        "values": _MEANING[bundle.values],
        "projections": {
            "shape_view_row_column": [len(bundle.geometry), *panel.shape],
            "pitch_u_v_mm": [panel.pitch_u, panel.pitch_v],
        },
        "volume": {
            "shape_z_y_x": list(grid.shape),
            "voxel_x_y_z_mm": grid.voxel.tolist(),
            "world_from_voxel": grid.affine.tolist(),
        },
    }


def _readme(form: Format, bundle: Bundle) -> str:
    panel = bundle.geometry.panel
    origin = "".join(f"{name}: {value}\n" for name, value in bundle.origin.items())
    files = "".join(f"{name:<16} {words}\n" for name, words in {**form.files, **_COMMON}.items())
    return f"""A CT scan for {form.title}, written by twinct

{origin}pixels: {_MEANING[bundle.values]}, {len(bundle.geometry)} views of \
{panel.rows} x {panel.columns} (rows x columns)

{files}{form.usage(bundle.grid)}
Coordinates are mm in the frame of the voxel grid: origin at its centre, axes along its own.
"world_from_voxel" in export.json maps voxel indices (x, y, z) to world mm, as in NIfTI.
{form.ending(bundle.grid)}"""
