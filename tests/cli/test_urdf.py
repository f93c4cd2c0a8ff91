"""``twinct urdf``: the room as a file that others read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from yourdfpy import URDF

from twinct.cli import run_command
from twinct.geometry.wire import PosePairs
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

DEMO = str(Path(__file__).parents[2] / "scenarios" / "demo.yaml")
BALL = (
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 60, mesh_resolution_mm: 4}, material: bone}]"
)


def test_the_room_is_written_with_meshes_and_camera(tmp_path: Path) -> None:
    out = tmp_path / "new" / "room"
    assert run_command(["urdf", DEMO, "--out", str(out), "--set", BALL]) == 0
    urdf = URDF.load(
        str(out / "cell.urdf"), filename_handler=lambda fname: fname.removeprefix("file://")
    )
    assert not urdf.errors
    [look] = urdf.link_map["specimen"].visuals
    assert Path(look.geometry.mesh.filename.removeprefix("file://")).parent == out

    # The camera is at the source of the first view: 600 mm before the panel, upside down.
    builder = SimulationBuilder(load_scenario(DEMO, [BALL]))
    source, detector = PosePairs.from_geometry(builder.requested)[0]
    found = detector.matrix @ _mm(urdf.get_transform("detector_optical", "detector"))
    np.testing.assert_allclose(found[:3, 3], source.position, atol=1e-6)
    np.testing.assert_allclose(found[:3, :3] @ [1, 0, 0], detector.rotation[:, 0], atol=1e-9)
    np.testing.assert_allclose(found[:3, :3] @ [0, 0, 1], -detector.rotation[:, 2], atol=1e-9)


def _mm(matrix: np.ndarray) -> np.ndarray:
    return np.block([[matrix[:3, :3], 1000 * matrix[:3, 3:]], [np.zeros((1, 3)), 1.0]])


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--set", "cell={kind: gantry}"], "has no arms"),
        (["--out", DEMO], "folder"),
    ],
)
def test_what_cannot_be_written_is_named(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, options: list[str], told: str
) -> None:
    assert run_command(["urdf", DEMO, "--out", str(tmp_path), "--set", BALL, *options]) == 2
    assert told in capfd.readouterr().err
