"""Geometry from the joint angles of both arms, through the kinematics of a cell."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.settings import Section, setting
from twinct.measured.numbers import read_numbers
from twinct.measured.views import ImageFacts, StatedViews


class Joints(Section):
    """Table of joint angles, a line for each view."""

    kind: Literal["joints"]
    path: Path = Field(
        description="Lines with the angles of the source arm's joints, then of the detector arm's."
    )
    array: str = setting("", "Name of the array in an .npz file.")
    unit: Literal["deg", "rad"] = Field(description="Unit of the angles.")
    scenario: Path = Field(
        description="Scenario with the cell, the panel, and perhaps uncertainty.calibration."
    )

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views, in the world of the scenario.

        Raises:
            InputError: the table does not fit the images or the cell, or the cell has no arms.
            ScenarioError: the scenario is invalid.
        """
        from twinct.scan.encoder_model import EncoderModel
        from twinct.scenario import Cell, load_scenario

        where = f"{self.path}: joints"
        table = read_numbers(self.path, self.array, where)
        if table.ndim != 2:
            raise InputError(f"{where}: shape {table.shape}; expected (views, joints)")
        self._check_unit(where, float(np.abs(table).max()))
        scenario = load_scenario(self.scenario)
        if not isinstance(scenario.cell, Cell):
            raise InputError(f"geometry.scenario: {self.scenario}: its cell is a gantry, not arms")
        panel = scenario.detector.panel
        facts.require(where, len(table))
        facts.require(f"{self.scenario}: detector", facts.views, panel)
        try:
            joints = np.radians(table) if self.unit == "deg" else table
            model = EncoderModel(scenario.cell, panel, scenario.uncertainty)
            geometry = model.poses(joints).geometry(panel)
        except (InputError, ValueError) as error:
            raise InputError(f"{where}: {error}") from None
        arms = "calibrated" if scenario.uncertainty.calibration else "nominal"
        size = f"{len(table)} views of {table.shape[1]} joints in {self.unit}, {arms} arms of "
        return StatedViews(geometry, notes=(f"{size}{self.scenario.name}, mm in its world",))

    def _check_unit(self, where: str, largest: float) -> None:
        if self.unit == "rad" and largest > 2 * math.tau:
            raise InputError(
                f"{where}: angles reach {largest:.4g} rad: are they in degrees? State unit: deg"
            )
        if self.unit == "deg" and largest <= math.tau:
            raise InputError(
                f"{where}: no angle exceeds {largest:.4g} deg: are they in radians? State unit: rad"
            )
