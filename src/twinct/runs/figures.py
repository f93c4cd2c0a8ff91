"""Figures of a finished run: the content of ``metrics.json``, some of it with types."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from twinct.evaluation import ImageFigures


class Figures(dict[str, Any]):
    """Content of ``metrics.json`` as nested dictionaries, and its main figures as attributes.

    ``figures.image.rmse_rel`` is ``figures["image"]["rmse_rel"]``. In an attribute a figure that
    is not finite, None in JSON, is NaN.
    """

    @property
    def image(self) -> ImageFigures:
        """Figures of the run's volume, from its first geometry."""
        return _image_figures(self["image"])

    @property
    def image_by_geometry(self) -> dict[str, ImageFigures]:
        """Figures of the volume from each geometry; empty for one geometry."""
        figures = self.get("image_by_geometry", {})
        return {name: _image_figures(values) for name, values in figures.items()}

    @property
    def pose_error(self) -> dict[str, dict[str, dict[str, float]]]:
        """Executed against commanded poses.

        By ``source`` or ``detector``, then ``position_mm`` or ``rotation_deg``, then ``mean``,
        ``std`` or ``max``.
        """
        return self["pose_error"]

    @property
    def believed_error(self) -> dict[str, dict[str, dict[str, float]]]:
        """Believed against executed poses, which the volume suffers from; as ``pose_error``."""
        return self["geometries"]["believed"]["pose_error"]

    @property
    def seconds(self) -> dict[str, float]:
        """Wall-clock seconds of each stage."""
        return self["seconds"]


def _image_figures(data: Mapping[str, Any]) -> ImageFigures:
    return ImageFigures.of({k: math.nan if value is None else value for k, value in data.items()})
