"""A small scenario of the CTSimU format."""

from __future__ import annotations

from typing import Any

from twinct.ctsimu.writing import header, material_entry, placed, quantity


def small_scenario() -> dict[str, Any]:
    """A 10 mm cube of aluminium half-way to a panel of 24 x 16 pixels of 2 mm, one energy."""
    return {
        "file": header("small", "for tests"),
        "environment": {"material_id": None},
        "geometry": {
            "detector": placed((400, 0, 0), (0, -1, 0), (1, 0, 0)),
            "source": {"type": "cone"} | placed((0, 0, 0), (0, -1, 0), (1, 0, 0)),
            "stage": placed((200, 0, 0), (1, 0, 0), (0, 0, 1)),
        },
        "detector": {
            "type": "ideal",
            "columns": quantity(24, "px"),
            "rows": quantity(16, "px"),
            "pixel_pitch": {"u": quantity(2.0, "mm"), "v": quantity(2.0, "mm")},
            "bit_depth": quantity(16),
            "integration_time": quantity(1.0, "s"),
            "gray_value": {"imax": quantity(60000), "imin": quantity(0)},
        },
        "source": {
            "voltage": quantity(80.0, "kV"),
            "current": quantity(1.0, "mA"),
            "spectrum": {"monochromatic": True},
        },
        "samples": [
            {
                "name": "cube",
                "file": {"value": "cube.stl"},
                "unit": "mm",
                "scaling_factor": {axis: quantity(1.0) for axis in "rst"},
                "material_id": "Al",
                "position": {
                    "center": {axis: quantity(0.0, "mm") for axis in "uvw"},
                    "vector_r": {"u": quantity(1), "v": quantity(0), "w": quantity(0)},
                    "vector_t": {"u": quantity(0), "v": quantity(0), "w": quantity(1)},
                    "deviations": [],
                },
            }
        ],
        "acquisition": {
            "start_angle": quantity(0.0, "deg"),
            "stop_angle": quantity(30.0, "deg"),
            "direction": "CCW",
            "scan_mode": "stop+go",
            "number_of_projections": 3,
            "include_final_angle": True,
            "frame_average": 1,
            "dark_field": {"number": 0},
            "flat_field": {"number": 0},
            "scattering": False,
        },
        "materials": [
            material_entry("Al", 2.6989, {"Al": 1.0}),
            material_entry("Fe", 7.874, {"Fe": 1.0}),
            material_entry("Vacuum", 0.0, {"": 1.0}),
        ],
    }
