"""A folder with all data that another toolkit needs for a reconstruction, and a loading script."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import ScanExistsError
from twinct.exchange.astra import astra_arrays
from twinct.exchange.cil import cil_arrays
from twinct.exchange.leap import leap_arrays
from twinct.exchange.openct import openct_json
from twinct.exchange.rtk import rtk_geometry_xml
from twinct.exchange.stack import Image, write_mha, write_npy, write_raw
from twinct.exchange.tigre import tigre_arrays
from twinct.geometry import ScanGeometry, VolumeGrid

Toolkit = Literal["rtk", "astra", "leap", "cil", "tigre", "openct"]
TOOLKITS: tuple[Toolkit, ...] = get_args(Toolkit)

Arrays = dict[str, NDArray[Any]]
_ARRAYS: dict[str, Callable[[ScanGeometry, VolumeGrid], Arrays]] = dict(
    astra=astra_arrays, leap=leap_arrays, cil=cil_arrays, tigre=tigre_arrays
)
_NAMES = {"astra": "the ASTRA Toolbox", "openct": "readers of OpenCT"}
Values = Literal["line-integrals", "transmission"]
_MEANING = {
    "line-integrals": "line integrals -ln(I/I0), mm times 1/mm",
    "transmission": "transmission I/I0",
}


@dataclass(frozen=True, eq=False)
class Bundle:
    """Data of a scan to export.

    Attributes:
        geometry: the views in world coordinates.
        grid: voxel grid of the reconstruction.
        images: one image (rows, columns) per view, float32, in the order of ``geometry``.
        values: quantity in the pixels.
        origin: source of the data, for the text files.
    """

    geometry: ScanGeometry
    grid: VolumeGrid
    images: Iterable[Image]
    values: Values
    origin: dict[str, str]

    @property
    def local(self) -> ScanGeometry:
        """Views in the grid's own frame: axis-aligned, centred on the origin."""
        return self.grid.world_from_grid.inverse() @ self.geometry


def bundle_bytes(geometry: ScanGeometry) -> int:
    """Return an upper limit of a bundle's size on disk, bytes."""
    return len(geometry) * (int(np.prod(geometry.panel.shape)) * 4 + 4096) + 2**20


def write_bundle(folder: Path, toolkit: Toolkit, bundle: Bundle) -> None:
    """Write a bundle; the folder appears under its name only when it is complete.

    Raises:
        ScanExistsError: the folder exists; it is not changed.
        InputError: the toolkit does not support the grid or a view; nothing is written.
        OSError: the disk is full or not writable; nothing is left behind.
    """
    if folder.exists():
        raise ScanExistsError(f"{folder} already exists: choose another --out")
    contents = _contents(toolkit, bundle)
    draft = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(draft, ignore_errors=True)
    try:
        draft.mkdir(parents=True)
        for name, write in contents.items():
            write(draft / name)
        (draft / "export.json").write_text(json.dumps(_facts(bundle), indent=2) + "\n")
        script = files("twinct.exchange").joinpath("scripts", f"{toolkit}.py")
        (draft / "load.py").write_text(script.read_text(encoding="utf-8"), encoding="utf-8")
        (draft / "README.txt").write_text(_readme(toolkit, bundle), encoding="utf-8")
        draft.rename(folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def _contents(toolkit: Toolkit, bundle: Bundle) -> dict[str, Callable[[Path], object]]:
    """Return the names of the toolkit's files with their writers; refuse unsupported geometry."""
    views, panel, local = len(bundle.geometry), bundle.geometry.panel, bundle.local
    if toolkit == "rtk":
        xml = rtk_geometry_xml(local)
        return {
            "geometry.xml": lambda path: path.write_text(xml, encoding="ascii"),
            "projections.mha": partial(write_mha, images=bundle.images, views=views, panel=panel),
        }
    if toolkit == "openct":
        names = [f"{view:04d}.raw" for view in range(views)]
        scan, transmission = bundle.origin.get("scan", ""), bundle.values == "transmission"
        words = openct_json(
            local, bundle.grid, scan, files=names, file_type="RAW", transmission=transmission
        )
        return {
            "openct.json": lambda path: path.write_text(json.dumps(words, indent=1) + "\n"),
            "projections": partial(write_raw, images=bundle.images, names=names),
        }
    arrays = _ARRAYS[toolkit](local, bundle.grid)
    return {
        "geometry.npz": lambda path: np.savez(path, allow_pickle=False, **arrays),
        "projections.npy": partial(write_npy, images=bundle.images, views=views, panel=panel),
    }


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


_FILES = {
    "rtk": """projections.mha  ITK image stack, (column, row, view) from the fastest axis on
geometry.xml     RTK's geometry, one Projection for each view""",
    "openct": """projections/     one image for each view: float32, first row on top, nothing else
openct.json      the scan as an OpenCT free trajectory""",
}
_ARRAY_FILES = """projections.npy  NumPy array (view, row, column), float32
geometry.npz     one array for each argument, by the toolkit's own names"""


def _readme(toolkit: Toolkit, bundle: Bundle) -> str:
    panel = bundle.geometry.panel
    origin = "".join(f"{name}: {value}\n" for name, value in bundle.origin.items())
    return f"""A CT scan for {_NAMES.get(toolkit, toolkit.upper())}, written by twinct

{origin}pixels: {_MEANING[bundle.values]}, {len(bundle.geometry)} views of \
{panel.rows} x {panel.columns} (rows x columns)

{_FILES.get(toolkit, _ARRAY_FILES)}
export.json      sizes, and where the volume is in the world
load.py          loads all of it
{_OPENCT if toolkit == "openct" else _reconstruct(bundle.grid)}
Coordinates are mm in the frame of the voxel grid: origin at its centre, axes along its own.
"world_from_voxel" in export.json maps voxel indices (x, y, z) to world mm, as in NIfTI.
{_program(bundle.grid) if toolkit == "rtk" else ""}"""


_OPENCT = """
Each matrix maps (x, y, z, 1) to (right w, down w, w), mm from the centre of the panel.
"""


def _reconstruct(grid: VolumeGrid) -> str:
    voxels = " x ".join(map(str, grid.shape))
    edges = " x ".join(f"{edge:g}" for edge in grid.voxel)
    return f"""
    python load.py --iterations 10 --out volume.npy

reconstructs it and writes the volume as (z, y, x): {voxels} voxels, {edges} mm along
(x, y, z), in 1/mm. twinct's own volume of the same scan lies on the same voxels, in the same order.

Columns run along +u, rows along +v of the panel; row 0, column 0 is the corner at -u, -v. Pixel
(row, column) is centred at D + (column - (columns - 1)/2) pitch u + (row - (rows - 1)/2) pitch v, D
the panel's centre.
"""


def _program(grid: VolumeGrid) -> str:
    count = ",".join(map(str, grid.shape_xyz))
    edges = ",".join(repr(edge) for edge in grid.voxel.tolist())
    return f"""
RTK's own programs read the folder as well:

    rtkconjugategradient -g geometry.xml -p . -r projections.mha -o volume.mha -n 10 \\
        --dimension {count} --spacing {edges} --nodisplaced
"""
