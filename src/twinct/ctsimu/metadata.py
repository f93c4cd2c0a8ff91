"""The metadata file beside the images, which the CTSimU toolbox reads."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from twinct.ctsimu.acquisition import FORMAT
from twinct.ctsimu.scenario import CtsimuScenario
from twinct.ctsimu.scene import FieldImages, Frame
from twinct.files.writing import write_json

if TYPE_CHECKING:
    from twinct.ctsimu.render import Files, Options


def write_metadata(
    files: Files, scenario: CtsimuScenario, options: Options, frame: Frame, brightest: float
) -> None:
    """Write it; it holds no clock times.

    Args:
        files: what was written.
        scenario: what was rendered.
        options: how.
        frame: the first frame.
        brightest: grey value of the brightest pixel of the free beam.
    """
    from twinct.version import __version__

    about = scenario.data.get("file") or {}
    across, down = frame.binning
    panel = frame.panel.binned(down, across)
    data = {
        "file": {
            "name": scenario.name,
            "description": about.get("description"),
            "contact": about.get("contact"),
            "date_created": about.get("date_created"),
            "date_changed": about.get("date_changed"),
            "file_type": "CTSimU Metadata",
            "file_format_version": {"major": FORMAT[0], "minor": FORMAT[1]},
        },
        "output": {
            "system": f"twinct {__version__}",
            "date_measured": None,
            "projections": {
                "filename": f"{scenario.name}_%04d.tif",
                "number": scenario.frames,
                "frame_average": scenario.average,
                "max_intensity": brightest,
                "datatype": "uint16",
                "byteorder": "little",
                "headersize": {"file": 0, "image": 0},
                "dimensions": {
                    "x": {"value": panel.columns, "unit": "px"},
                    "y": {"value": panel.rows, "unit": "px"},
                },
                "pixelsize": {
                    "x": {"value": panel.pitch_u, "unit": "mm"},
                    "y": {"value": panel.pitch_v, "unit": "mm"},
                },
                "dark_field": _field(scenario.name, "dark", scenario.dark),
                "flat_field": _field(scenario.name, "flat", scenario.flat),
                "bad_pixel_map": {"filename": None, "projections_corrected": False},
            },
            "tomogram": None,
        },
        "acquisition_geometry": {
            "path_to_CTSimU_JSON": os.path.relpath(scenario.path, files.folder)
        },
        "reconstruction": {"software": None, "settings": {}},
        "simulation": {
            "twinct": {
                "samples_per_pixel_edge": options.samples,
                "spot_points": options.spot_points,
                "seed": options.seed,
            },
            "ctsimu_scenario": scenario.data,
        },
    }
    write_json(files.metadata, data)


def _field(name: str, kind: str, images: FieldImages) -> dict[str, Any]:
    number = "_%04d" if images.number > 1 else ""
    return {
        "number": images.number,
        "frame_average": images.average,
        "filename": f"{name}_{kind}{number}.tif" if images.number else None,
        "projections_corrected": images.correction,
    }
