"""A clinical CT of a chest with TotalSegmentator's labels (tools/fetch-chest)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twinct.scenario import Specimen
from twinct.specimen import build_specimen
from twinct.specimen.materials import BUILT_IN

CHEST = Path(__file__).parents[2] / "data" / "chest"
NAMES = {"liver": 5, "lung_upper_lobe_left": 10, "heart": 51, "spinal_cord": 79, "vertebrae_T8": 36}


@pytest.mark.tutorial
@pytest.mark.skipif(not (CHEST / "mask.nii.gz").exists(), reason="needs tools/fetch-chest")
def test_a_chest_keeps_its_tissues_and_loses_its_couch(
    figure: Callable[[str], None], caplog: pytest.LogCaptureFixture
) -> None:
    labels = {"path": str(CHEST / "mask.nii.gz"), "names": NAMES}
    shape = {"kind": "volume", "path": str(CHEST / "cxr.nii.gz"), "keep": "body", "labels": labels}
    section = Specimen.model_validate({"parts": [{"shape": shape}]}, strict=False)
    (part,) = build_specimen(section).mixtures
    assert "its field of view cuts the body: 157 cm2" in caplog.text
    assert [face.name for face in part.cuts] == ["-x", "+x", "-z", "+z"]
    water = BUILT_IN["water"].mu_per_mm(71.6)
    hu = {name: 1000 * (part.mean_mu(71.6, name) / water - 1) for name in part.label_names}
    figure(", ".join(f"{name} {value:.0f}" for name, value in hu.items()))
    assert 40 < hu["liver"] < 120 and 10 < hu["spinal_cord"] < 60
    assert -900 < hu["lung_upper_lobe_left"] < -750 and 200 < hu["vertebrae_T8"] < 400
    # The couch lies below the back, outside the body's 15 litres.
    assert part.volume_mm3 / 1e6 == pytest.approx(15.1, abs=0.3)
    assert np.ptp(part.mesh.bounds[:, 1]) == pytest.approx(263, abs=3)
