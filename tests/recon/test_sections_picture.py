"""Sections of a volume in a notebook, with sliders (ipywidgets)."""

from __future__ import annotations

import numpy as np
import pytest

from twinct import Volume
from twinct.core.files.pictures import notebook_widgets
from twinct.geometry import VolumeGrid
from twinct.recon.sections_picture import sections_with_sliders

GRID = VolumeGrid((4, 6, 8), 1.0)


def test_outside_a_notebook_there_are_no_sliders() -> None:
    assert notebook_widgets() is None


def test_a_slider_for_each_axis_moves_its_section() -> None:
    widgets = pytest.importorskip("ipywidgets", reason="needs ipywidgets")
    volume = Volume(np.arange(4 * 6 * 8, dtype=np.float32).reshape(4, 6, 8), GRID)
    shown = sections_with_sliders(volume.array, volume.grid, widgets)
    picture, sliders = shown.children[0], shown.children[1].children
    assert [(one.description, one.value, one.max) for one in sliders] == [
        ("x", 4, 7),
        ("y", 3, 5),
        ("z", 2, 3),
    ]
    at_first = bytes(picture.value)
    assert at_first.startswith(b"\x89PNG")
    sliders[2].value = 0
    moved = bytes(picture.value)
    assert moved != at_first
    sliders[2].value = 2
    assert bytes(picture.value) == at_first
