"""
A mesh of your own
==================

A part from a file: STL, PLY, OBJ or OFF. Here trimesh makes one, a block with a hole.
"""

import trimesh

from twinct import load_scenario, reconstruct, simulate

block = trimesh.creation.annulus(r_min=8, r_max=30, height=30)
block.export("ring.stl")
SMALL = {
    "specimen.parts": [{"shape": {"kind": "mesh", "path": "ring.stl"}, "material": "aluminium"}],
    "xray.engine": "mesh",
    "trajectory.views": 60,
    "detector": {"columns": 128, "rows": 64, "pixel_pitch_mm": 2},
    "reconstruction.grid": {"voxels": 72, "voxel_mm": 1},
}
scan = simulate(load_scenario("circle_gantry", SMALL))
scan.show("own_mesh_scan.png")
reconstruct(scan, algorithm="fast").show("own_mesh_volume.png")
