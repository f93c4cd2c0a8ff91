"""Output files of a rendering: names of the images, and the metadata file for the toolbox."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinct.core.files.writing import write_json
from twinct.ctsimu.acquisition import FORMAT
from twinct.ctsimu.scenario import CtsimuScenario
from twinct.ctsimu.scene import DarkOrFlatImages, Frame
from twinct.ctsimu.writing import quantity
from twinct.version import __version__


@dataclass(frozen=True)
class Options:
    """Options that a scenario leaves to the software.

    Attributes:
        samples: rays along each pixel edge, for a point source.
        spot_points: points of an extended focal spot.
        seed: seed of the noise.
    """

    samples: int = 3
    spot_points: int = 32
    seed: int = 0


@dataclass(frozen=True)
class OutputPaths:
    """Paths of the output files."""

    folder: Path
    name: str

    @property
    def metadata(self) -> Path:
        """Metadata file for the CTSimU toolbox; written last."""
        return self.folder / f"{self.name}_metadata.json"

    @property
    def key(self) -> Path:
        """File that identifies the rendering in the folder."""
        return self.folder / f"{self.name}_rendering.json"

    def projection(self, index: int) -> Path:
        """Return the path of a projection."""
        return self.folder / f"{self.name}_{index:04d}.tif"

    def field(self, kind: str, index: int, count: int) -> Path:
        """Return the path of a dark or flat image."""
        number = f"_{index:04d}" if count > 1 else ""
        return self.folder / f"{self.name}_{kind}{number}.tif"


def write_metadata(
    files: OutputPaths, scenario: CtsimuScenario, options: Options, frame: Frame, brightest: float
) -> None:
    """Write the metadata of a rendering and its settings, without clock times.

    ``frame`` is the first frame; ``brightest`` is the grey value of the brightest pixel of the free
    beam.
    """
    about = scenario.data.get("file") or {}
    across, down = frame.binning
    panel = frame.panel.binned(down, across)
    data = {
        "file": {
            "name": scenario.name,
            **{k: about.get(k) for k in ("description", "contact", "date_created", "date_changed")},
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
                "dimensions": {"x": quantity(panel.columns, "px"), "y": quantity(panel.rows, "px")},
                "pixelsize": {
                    "x": quantity(panel.pitch_u, "mm"),
                    "y": quantity(panel.pitch_v, "mm"),
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


def _field(name: str, kind: str, images: DarkOrFlatImages) -> dict[str, Any]:
    number = "_%04d" if images.number > 1 else ""
    return {
        "number": images.number,
        "frame_average": images.average,
        "filename": f"{name}_{kind}{number}.tif" if images.number else None,
        "projections_corrected": images.correction,
    }
