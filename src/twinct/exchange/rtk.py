"""Geometry for RTK: XML with three distances, three angles and four offsets per view.

RTK (``ThreeDCircularProjectionGeometry``) maps a point with

    T(sx - px, sy - py) diag(-SDD, -SDD, 1) T(-sx, -sy, -SOD) Rz(-in) Rx(-out) Ry(-gantry),

where SOD is RTK's ``SourceToIsocenterDistance``. The rotation has the rows u, v and n = u x v, so
any view fits. RTK's reader recomputes each matrix from the parameters and compares it with the one
in the file.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.exchange.format import Bundle, Format, own_script, reconstruct_usage
from twinct.exchange.stack import write_mha
from twinct.geometry import Floats, ScanGeometry, VolumeGrid

VERSION = 3
"""Version of RTK's geometry file, since RTK 2.0."""


def rtk_parameters(geometry: ScanGeometry) -> dict[str, Floats]:
    """Return RTK's parameters by their XML names, each (views,), degrees and mm."""
    rows = np.stack([geometry.u, geometry.v, geometry.normal], axis=1)
    source = np.einsum("ijk,ik->ij", rows, geometry.source)
    detector = np.einsum("ijk,ik->ij", rows, geometry.detector)
    with warnings.catch_warnings():
        # At 90 degrees out of plane, one angle is free and becomes zero.
        warnings.filterwarnings("ignore", message="Gimbal lock")
        turns = scipy.spatial.transform.Rotation.from_matrix(rows)
        angles = -turns.as_euler("ZXY", degrees=True) % 360
    return {
        "GantryAngle": angles[:, 2],
        "SourceToIsocenterDistance": source[:, 2],
        "SourceToDetectorDistance": geometry.sdd,
        "SourceOffsetX": source[:, 0],
        "SourceOffsetY": source[:, 1],
        "ProjectionOffsetX": detector[:, 0],
        "ProjectionOffsetY": detector[:, 1],
        "InPlaneAngle": angles[:, 0],
        "OutOfPlaneAngle": angles[:, 1],
    }


def rtk_matrices(geometry: ScanGeometry) -> NDArray[np.float64]:
    """Return (views, 3, 4): mm to (x w, y w, w), x and y in mm on the panel from its centre."""
    # RTK's w increases towards the source.
    return -(geometry.panel.mm_from_pixel @ geometry.matrices())


def rtk_geometry_xml(geometry: ScanGeometry) -> str:
    """Return XML for ``ThreeDCircularProjectionGeometryXMLFileReader`` and all RTK programs."""
    root = ElementTree.Element("RTKThreeDCircularGeometry", version=str(VERSION))
    parameters = rtk_parameters(geometry)
    for view, matrix in enumerate(rtk_matrices(geometry)):
        projection = ElementTree.SubElement(root, "Projection")
        for name, values in parameters.items():
            ElementTree.SubElement(projection, name).text = repr(float(values[view]))
        text = "\n".join(" ".join(repr(float(value)) for value in row) for row in matrix)
        ElementTree.SubElement(projection, "Matrix").text = f"\n{text}\n"
    ElementTree.indent(root)
    head = '<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n'
    return head + ElementTree.tostring(root, encoding="unicode") + "\n"


def _write(bundle: Bundle, folder: Path) -> None:
    (folder / "geometry.xml").write_text(rtk_geometry_xml(bundle.local), encoding="ascii")
    write_mha(folder / "projections.mha", bundle)


def _program(grid: VolumeGrid) -> str:
    count = ",".join(map(str, grid.shape_xyz))
    edges = ",".join(repr(edge) for edge in grid.voxel.tolist())
    return f"""
RTK's own programs read the folder as well:

    rtkconjugategradient -g geometry.xml -p . -r projections.mha -o volume.mha -n 10 \\
        --dimension {count} --spacing {edges} --nodisplaced
"""


RTK = Format(
    "rtk",
    "RTK",
    {
        "projections.mha": "ITK image stack, (column, row, view) from the fastest axis on",
        "geometry.xml": "RTK's geometry, one Projection for each view",
    },
    _write,
    own_script("rtk"),
    usage=reconstruct_usage,
    ending=_program,
)
