"""Geometry for OpenCT: a free trajectory as projection matrices in JSON, beside raw images.

The code follows the writer of BAM's CTSimU toolbox (``create_OpenCT_config`` and
``projection_matrix`` of ctsimu), the only public description of the format. Image rows run
downwards there, along -v. The toolbox's volume is rotated by 180 degrees about z relative to the
world; ours is not.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twinct.exchange.format import Bundle, Format, own_script
from twinct.exchange.rtk import rtk_matrices
from twinct.exchange.stack import write_raw
from twinct.geometry import ScanGeometry, VolumeGrid

_DOWN = np.diag([1.0, -1.0, 1.0])
_IN_PLANE = 1e-12
"""Sine of an angle that counts as a rounding error."""


def openct_matrices(geometry: ScanGeometry) -> NDArray[np.float64]:
    """Return (views, 3, 4): point in mm to (right w, down w, w), mm on the panel from its centre.

    As in the toolbox, the lower right element is scaled to 1. It is 0 if the origin lies in the
    plane through the source parallel to the panel; such a matrix is not scaled.
    """
    matrices = _DOWN @ rtk_matrices(geometry)
    corner = matrices[:, 2, 3]
    beside = np.abs(corner) <= _IN_PLANE * np.linalg.norm(geometry.source, axis=1)
    return matrices / np.where(beside, 1.0, corner)[:, None, None]


def openct_json(
    geometry: ScanGeometry,
    grid: VolumeGrid,
    name: str,
    *,
    files: Sequence[str],
    file_type: Literal["RAW", "TIFF"],
    transmission: bool,
) -> dict[str, Any]:
    """Return the description of a scan whose images lie in ``projections``, first row on top.

    ``name`` is the volume's name. The format takes the box around the voxels, not their number.
    Each view has one file, float32, of transmission I/I0 or of line integrals.
    """
    panel = geometry.panel
    to_source = np.einsum("ij,ij->i", geometry.normal, geometry.source)
    to_panel = np.einsum("ij,ij->i", geometry.normal, -geometry.detector)
    return {
        "version": {"major": 1, "minor": 0},
        "OpenCTJSON": {
            "versionMajor": 1,
            "versionMinor": 0,
            "revisionNumber": 0,
            "variant": "FreeTrajectoryCBCTScan",
        },
        "hints": None,
        "units": {"length": "Millimeter", "angle": "Degree"},
        "volumeName": name,
        "projections": {
            "numProjections": len(geometry),
            "intensityDomain": transmission,
            "images": {
                "dataType": "Float32",
                "fileType": file_type,
                "skipBytes": 0,
                "endianness": "Little",
                "directory": "projections",
                "files": list(files),
            },
            "detectorCoordinateFrame": "OriginAtDetectorCenter.VerticalAxisRunningDownwards",
            "detectorCoordinateDimension": "Length",
            "matrices": openct_matrices(geometry).tolist(),
        },
        "geometry": {
            "detectorPixel": [panel.columns, panel.rows],
            "detectorSize": list(panel.size_mm),
            "distanceSourceObject": float(to_source.mean()),
            "distanceObjectDetector": float(to_panel.mean()),
            "mirrorDetectorAxis": "",
            "skipAngle": 0,
            "totalAngle": None,
            "objectBoundingBox": {"centerXYZ": [0.0, 0.0, 0.0], "sizeXYZ": grid.size_mm.tolist()},
        },
        "corrections": None,
    }


def _write(bundle: Bundle, folder: Path) -> None:
    names = [f"{view:04d}.raw" for view in range(len(bundle.geometry))]
    words = openct_json(
        bundle.local,
        bundle.grid,
        bundle.origin.get("scan", ""),
        files=names,
        file_type="RAW",
        transmission=bundle.values == "transmission",
    )
    (folder / "openct.json").write_text(json.dumps(words, indent=1) + "\n")
    write_raw(folder / "projections", bundle, names)


_MATRICES = """
Each matrix maps (x, y, z, 1) to (right w, down w, w), mm from the centre of the panel.
"""

OPENCT = Format(
    "openct",
    "readers of OpenCT",
    {
        "projections/": "one image for each view: float32, first row on top, nothing else",
        "openct.json": "the scan as an OpenCT free trajectory",
    },
    _write,
    own_script("openct"),
    usage=lambda grid: _MATRICES,
)
