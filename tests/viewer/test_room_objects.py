"""Objects of the room on the page: in their colour, and translucent where they are."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Pose
from twinct.robots.cell import build_cell
from twinct.scenario import Cell, Detector
from twinct.viewer.room import Room

SHAPE = {"kind": "box", "size_mm": [100, 100, 100]}


def test_objects_and_zones_have_their_colour_and_opacity() -> None:
    cell = Cell.model_validate(
        {
            "objects": [
                {"name": "lamp", "shape": SHAPE, "colour": "#ff8000"},
                {"name": "curtain", "shape": SHAPE, "colour": "#00ff0040"},
            ],
            "zones": [{"name": "nurse", "shape": SHAPE}],
        }
    )
    room = Room(build_cell(cell, None, Pose.identity(), Detector().panel))
    materials = {body.name: getattr(body.mesh.visual, "material", None) for body in room.bodies}
    lamp, curtain = materials["object lamp"], materials["object curtain"]
    # A browser's materials state light: 0x80 of a screen is 0.22 of the light.
    assert lamp.baseColorFactor == pytest.approx([255, 56, 0, 255], abs=1)
    assert np.asarray(curtain.baseColorFactor)[3] == 64
    assert (lamp.alphaMode, curtain.alphaMode) == ("OPAQUE", "BLEND")
    assert materials["zone nurse"].alphaMode == "BLEND"
    assert lamp.metallicFactor == 0
