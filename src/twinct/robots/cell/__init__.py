"""Robot cell: two arms with source and panel, table and specimen, as one MuJoCo model.

MuJoCo is imported when a cell is built, not together with this package.
"""

from twinct.robots.cell._mujoco import mujoco, mujoco_module
from twinct.robots.cell.bodies import BodyPlaces
from twinct.robots.cell.chains import chains_of, joint_names_of, nominal_chains
from twinct.robots.cell.clearance import Clearance, Gap
from twinct.robots.cell.fixed import Overlap, apart, overlaps
from twinct.robots.cell.frames import LinkFrames
from twinct.robots.cell.gantry_clearance import GantryClearance, require_free_way
from twinct.robots.cell.render import (
    Marks,
    PictureContent,
    check_drawing,
    check_picture_size,
    paint_specimen,
    path_marks,
    render_cell,
    room_pictures,
    tell_if_undrawable,
    whole_camera,
)
from twinct.robots.cell.scene import (
    CellModel,
    GantryModel,
    build_cell,
    build_gantry,
)
from twinct.robots.cell.urdf import OPTICAL, cell_urdf

__all__ = [
    "BodyPlaces",
    "LinkFrames",
    "OPTICAL",
    "CellModel",
    "Clearance",
    "GantryClearance",
    "GantryModel",
    "Gap",
    "Marks",
    "PictureContent",
    "Overlap",
    "apart",
    "build_cell",
    "build_gantry",
    "cell_urdf",
    "chains_of",
    "check_drawing",
    "check_picture_size",
    "mujoco",
    "mujoco_module",
    "joint_names_of",
    "nominal_chains",
    "overlaps",
    "paint_specimen",
    "render_cell",
    "require_free_way",
    "room_pictures",
    "path_marks",
    "tell_if_undrawable",
    "whole_camera",
]
