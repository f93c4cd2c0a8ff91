"""The operating room: two arms with source and panel, table, specimen, as one MuJoCo model.

MuJoCo is imported when a cell is built, not when this package is.
"""

from twinct.cell._mujoco import mujoco_module
from twinct.cell.clearance import Clearance, Gap
from twinct.cell.render import check_drawing, check_picture_size, render_cell
from twinct.cell.scene import CellModel, build_cell

__all__ = [
    "CellModel",
    "Clearance",
    "Gap",
    "build_cell",
    "check_drawing",
    "check_picture_size",
    "mujoco_module",
    "render_cell",
]
