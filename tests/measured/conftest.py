"""Imports of a small circular scan, as arrays that a machine may have stored."""

from __future__ import annotations

import numpy as np
import pytest
from ball_scan import PITCH, SDD, SOD, VIEWS

from twinct.measured import description_of, import_measured
from twinct.runs import load_scan


@pytest.fixture
def circle():
    """Keys of the section ``geometry`` of ``orbit``, with rows stored from the bottom."""
    return {
        "kind": "circle",
        "sod_mm": SOD,
        "sdd_mm": SDD,
        "pitch_mm": PITCH,
        "angles": {"step": 360 / VIEWS},
        "rotates": "source",
        "direction": "counterclockwise",
        "rows": "up",
    }


@pytest.fixture
def imported(tmp_path):
    """A function that imports a description, or the source at a path, and loads its scan."""
    count = iter(range(100))

    def run(source):
        out = tmp_path / f"imported{next(count)}"
        told = import_measured(source if isinstance(source, dict) else description_of(source), out)
        return load_scan(out), told

    return run


@pytest.fixture
def stored(tmp_path):
    """A function that stores an array and returns the keys of ``images`` for line integrals."""

    def save(array, values="line_integrals", **keys):
        path = tmp_path / "images.npy"
        np.save(path, array)
        return {"path": str(path), "values": values, **keys}

    return save
