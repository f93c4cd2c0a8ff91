"""The curves and pictures that a CTSimU file refers to: read once, before anything is rendered.

Meshes are left to the rendering: they take long, and a broken one is named before its first image.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from twinct.ctsimu.scene import Frame
from twinct.errors import InputError
from twinct.files.images import read_image
from twinct.files.tables import read_curve


def wrong_references(frame: Frame, seen: set[object]) -> list[str]:
    """One sentence for each file that does not hold what it should, with its key.

    Args:
        frame: refers to them.
        seen: files that were read already; these are added.
    """
    response = frame.response
    reads: dict[str, tuple[object, Callable[[], object]]] = {}
    for key, path in (
        ("source.spectrum.file", frame.tube.spectrum),
        ("detector.gray_value.intensity_characteristics_file", response.curve),
        ("detector.gray_value.efficiency_characteristics_file", response.efficiency),
        ("detector.noise.noise_characteristics_file", response.noise),
        ("detector.unsharpness.mtf", response.mtf),
    ):
        if path is not None:
            reads[key] = path, partial(read_curve, path)
    if (spot := frame.spot.image) is not None:
        what = "a focal spot"
        reads["source.spot.intensity_map.file"] = spot, partial(read_image, spot, what)
    if (bad := response.bad_pixels) is not None:
        shape = frame.panel.shape
        reads["detector.bad_pixel_map.file"] = bad, partial(read_image, bad, "bad pixels", shape)
    problems = []
    for key, (file, read) in reads.items():
        if (key, file) not in seen:
            seen.add((key, file))
            try:
                read()
            except InputError as error:
                problems.extend(f"{key}: {problem}" for problem in error.problems)
    return problems
