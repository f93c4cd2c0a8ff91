"""mAs that differ from view to view, from the file of views to the store."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from twinct.core.errors import ScanExistsError
from twinct.runs import reconstruct, simulate
from twinct.scan import ScanStore, SimulationBuilder, image_digests
from twinct.scenario import parse_scenario
from twinct.trajectory import commanded_views, write_views

MAS = np.array([0.02, 0.005, 0.01, 0.04])


def scenario(path, mas=None, **more):
    told = {
        "source": {"photons_per_mm2_mas": 1e6},
        "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8.0, **more},
        "trajectory": {"kind": "circle", "views": 4},
        "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 40}}]},
        "cell": {"kind": "gantry"},
    }
    circle = parse_scenario(told)
    write_views(path, commanded_views(circle.trajectory, circle.detector.panel), mas)
    return parse_scenario(told | {"trajectory": {"kind": "file", "path": str(path)}})


def test_a_scan_takes_and_keeps_the_mas_of_its_file(tmp_path):
    noise = {"noise": {"kind": "quantum"}, "response": {"kind": "counting"}}
    uneven = simulate(scenario(tmp_path / "a.csv", MAS, **noise))
    even = simulate(scenario(tmp_path / "b.csv", **noise))
    np.testing.assert_array_equal(uneven.mas, MAS)
    assert even.mas is None
    free = np.s_[:, :, :8]
    relative = uneven.transmission[free].var(axis=(1, 2)) / even.transmission[free].var(axis=(1, 2))
    # The source has 0.01 mAs. A variance of 240 pixels: 9 %, one deviation.
    np.testing.assert_allclose(relative, 0.01 / MAS, rtol=0.5)
    assert (np.argsort(relative) == np.argsort(-MAS)).all()
    # The photons that the reconstruction gets, and line integrals that few of them do not bias.
    np.testing.assert_allclose(uneven.photons / even.photons, MAS / 0.01)
    assert even.photons[0] * even.transmission[free].var() == pytest.approx(1, rel=0.2)
    plain = -np.log(even.transmission)
    np.testing.assert_allclose(even.line_integrals()[free], plain[free] - 0.5 / even.photons[0],
        rtol=0, atol=2e-2 / even.photons[0])  # fmt: skip
    thin = {"grid": {"voxels": 16, "voxel_mm": 1.0}, "algorithm": "fast"}
    assert reconstruct(even, **thin).extras["regularisation"]["from"] == "photons"


def test_other_mas_are_another_scan(tmp_path):
    first = scenario(tmp_path / "a.csv", MAS)
    path = tmp_path / "scan.zarr"
    store = ScanStore.create(path, first, SimulationBuilder(first).commanded_poses, (), 15, mas=MAS)
    assert store.refuse_other(image_digests(first)) is None
    for other in (MAS[::-1], None):
        with pytest.raises(ScanExistsError, match="of another scenario"):
            store.refuse_other(image_digests(scenario(tmp_path / "b.csv", other)))


def test_mas_stay_with_their_views_where_the_plan_chooses_the_order(tmp_path):
    given = scenario(tmp_path / "a.csv", MAS)
    arms = parse_scenario(
        given.model_dump(mode="json", exclude={"cell"}) | {"motion": {"order": "shortest"}}
    )
    turned = SimulationBuilder(given).targets[::-1]
    builder = SimulationBuilder(arms, given_plan=cast(Any, SimpleNamespace(targets=tuple(turned))))
    assert builder.plan_chooses
    np.testing.assert_array_equal(builder.mas, MAS[::-1])
