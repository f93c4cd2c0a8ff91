"""Patients beside the table under them: a warning before work starts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.core.foreign_text import quoted
from twinct.geometry import Floats
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell

LIES_MM = 20.0
"""Largest distance of a patient's lowest point from the top of a table that carries the patient."""

OVERHANG_MM = 1.0
"""Way beyond the table from which a patient counts as larger."""

SIDES = ("-x", "+x", "-y", "+y")


def larger_than_table(builder: SimulationBuilder) -> list[str]:
    """Return a warning for each patient, a mixture of materials, beyond the edge of a table."""
    specimen, warnings = builder.specimen, list[str]()
    place = specimen.world_from_specimen
    for patient in specimen.mixtures:
        body = _bounds(place.apply(np.asarray(patient.mesh.vertices)))
        for name, table in _tables(builder):
            over = _overhang(body, table)
            beyond = [
                f"{mm:.0f} mm at {side}"
                for mm, side in zip(over, SIDES, strict=True)
                if mm > OVERHANG_MM
            ]
            if beyond:
                wide, long = np.diff(body, axis=0)[0, :2]
                at_most = " x ".join(f"{edge:g}" for edge in np.diff(table, axis=0)[0, :2].round(1))
                warnings.append(
                    f"part {quoted(patient.name)} is larger than {name} under it: it measures "
                    f"{wide:.0f} x {long:.0f} mm along x and y of the world, the table {at_most} "
                    f"mm, and reaches {', '.join(beyond)} beyond it"
                )
    return warnings


def _tables(builder: SimulationBuilder) -> Iterator[tuple[str, Floats]]:
    """Yield name and bounds (2, 3) in the world of everything that may carry a patient."""
    place = builder.specimen.world_from_specimen
    for part in builder.specimen.pure:
        yield quoted(part.name), _bounds(place.apply(np.asarray(part.mesh.vertices)))
    cell = builder.scenario.cell
    if isinstance(cell, Cell) and cell.table.present:
        half, top = np.array(cell.table.size_mm) / 2, cell.table.top_z_mm
        low = np.array([-half[0], -half[1], top - 2 * half[2]])
        yield "cell.table", np.stack([low, np.array([half[0], half[1], top])])


def _overhang(body: Floats, table: Floats) -> list[float]:
    """Return how far a body reaches beyond a table at each side; zeros if it does not lie on it."""
    apart = (body[0, :2] >= table[1, :2]).any() or (table[0, :2] >= body[1, :2]).any()
    if apart or abs(body[0, 2] - table[1, 2]) > LIES_MM or table[0, 2] > body[0, 2]:
        return [0.0] * len(SIDES)
    low, high = table[0, :2] - body[0, :2], body[1, :2] - table[1, :2]
    return [float(low[0]), float(high[0]), float(low[1]), float(high[1])]


def _bounds(points: Floats) -> Floats:
    return np.stack([points.min(axis=0), points.max(axis=0)])
