"""The samples of the qualification suite are what the tests ask for."""

from __future__ import annotations

import errno
from unittest.mock import Mock

import numpy as np
import pytest

from twinct.core.errors import InputError, StorageError
from twinct.core.files.meshes import open_edges
from twinct.ctsimu import suite
from twinct.ctsimu.suite import NOT_TAKEN, TESTS, qualify, samples
from twinct.ctsimu.suite.cases import WEDGE_PANEL_MM, WEDGE_PITCH_MM, cases
from twinct.ctsimu.suite.verdicts import verdicts
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.specimen import BuiltPart, material
from twinct.xray.paths import PathRenderer

ALUMINIUM = material("aluminium")


def paths(mesh, panel_mm, panel):
    """Path lengths of a mesh in the world, row 0 on top."""
    view = ScanGeometry([[0, 0, 0]], [[panel_mm, 0, 0]], [[0, -1, 0]], [[0, 0, 1]], panel)
    with PathRenderer([BuiltPart("block", ALUMINIUM, mesh)], panel) as renderer:
        return renderer.render(view, Pose.identity())[0][::-1]


def test_every_ray_of_a_step_crosses_its_thickness():
    mesh = samples.wedge(WEDGE_PANEL_MM, WEDGE_PITCH_MM)
    assert open_edges(mesh) == 0
    # Every tenth row and column of the test's panel.
    lengths = paths(mesh, WEDGE_PANEL_MM, Panel(100, 100, 10 * WEDGE_PITCH_MM, 10 * WEDGE_PITCH_MM))
    for step, (first, last) in enumerate(
        [(819, 908), (728, 817), (637, 726), (546, 635), (455, 544), (364, 453), (273, 362),
         (182, 271), (91, 180)]
    ):  # fmt: skip
        rows = [r for r in range(100) if first <= 10 * r + 4.5 <= last]
        inside = lengths[rows][:, 10:89]
        assert inside.min() > 0
        np.testing.assert_allclose(inside, samples.WEDGE_STEPS_MM[step], atol=0.004)
    assert not lengths[:9].any() and not lengths[:, :8].any() and not lengths[:, 91:].any()


def test_edge_turns_about_the_corner_on_the_axis():
    # 21 x 21 pixels of 0.4 mm: the corner meets the middle of the middle one.
    covered = paths(samples.edge(500.0), 1000.0, Panel(21, 21, 0.4, 0.4)) > 0.005
    y, x = np.mgrid[-10:11, -10:11].astype(float)
    tan = np.tan(np.radians(3.0))
    expected = (x < -y * tan) & (y > x * tan)
    clear = np.minimum(np.abs(x + y * tan), np.abs(y - x * tan)) > 0.05
    np.testing.assert_array_equal(covered[clear], expected[clear])


def test_wires_show_their_diameters_and_gaps():
    mesh = samples.duplex_wires(1000.0, (0.0, 0.0), 52.5)
    assert open_edges(mesh) == 0
    turn = np.array([np.cos(samples.TILT_RAD), -np.sin(samples.TILT_RAD)])
    flat = -np.asarray(mesh.vertices)[:, 1:] * 1000.0 / np.asarray(mesh.vertices)[:, :1]
    along = np.sort(flat @ (turn * [1, -1]))
    gaps = np.diff(along)
    wide = gaps[gaps > 0.049]
    # Between the two wires of a pair, then to the next pair.
    np.testing.assert_allclose(wide[0::2], samples.WIRE_MM, rtol=0.02)
    np.testing.assert_allclose(wide[1::2], samples.WIRE_APART_MM, rtol=0.01)


def test_pieces_overlap_touch_and_part():
    assert [samples.overlap_px(y) for y in (500, 7000 / 11, 10000 / 11)] == pytest.approx(
        [0, 0, 10]
    )
    assert [samples.gap_px(y) for y in (500, 4000 / 11, 1000 / 11)] == pytest.approx([0, 0, 5])


def test_all_cases_have_names_of_their_own():
    found = cases(["2D-FB-1", "2D-SW-1", "2D-SW-2", "2D-SW-3", "2D-WE-1"])
    assert len({case.name for case in found}) == len(found) == 2 + 16 + 4 + 2 + 2


def test_unknown_test_is_refused(tmp_path):
    with pytest.raises(InputError, match="2D-XX-1.*2D-FB-1"):
        qualify(tmp_path, ["2D-XX-1"])


def test_toolbox_judges_the_free_beam(tmp_path):
    pytest.importorskip("ctsimu.toolbox", reason="needs the extra ctsimu")
    verdict = qualify(tmp_path, ["2D-FB-2"])[0]
    assert verdict.passed and verdict.test == "2D-FB-2"
    assert (tmp_path / "qualification.json").is_file()


def test_a_full_disk_is_told_whoever_meets_it(tmp_path, monkeypatch):
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(suite, "render", Mock(side_effect=full))
    monkeypatch.setattr(suite, "_toolbox", Mock())
    with pytest.raises(StorageError, match="the disk is full"):
        qualify(tmp_path, ["2D-FB-2"])


def test_the_tests_left_out_are_named_with_the_reason(tmp_path):
    with pytest.raises(InputError, match="2D-SW-4 is not supported: .*scatter"):
        qualify(tmp_path, ["2D-SW-4"])
    assert set(TESTS) | set(NOT_TAKEN) == {
        *("2D-FB-1", "2D-FB-2", "2D-HS-1", "2D-DW-1", "2D-WE-1", "2D-WE-2"),
        *("2D-SW-1", "2D-SW-2", "2D-SW-3", "2D-SW-4"),
    }


def test_iron_at_one_energy_is_no_pass(tmp_path):
    """Its steps were taken from the reference: it would pass whatever we render."""
    names = [f"{d}_{beam}" for d in ("D1", "D2") for beam in ("Al_50", "Fe_100", "Fe_200")]
    row = "\t".join(["1"] * len(names))
    (tmp_path / "2D-SW-1_all_GV_ratios_to_Det1.txt").write_text(
        "step\t" + "\t".join(names) + f"\n1\t{row}\n2\t{row}\n"
    )
    reference = np.column_stack([[1, 2], *[np.full(2, x) for _ in names for x in (1, 0.1, 0.1)]])
    np.savetxt(tmp_path / "2D-SW-1_all_MCprimary_reference_ratios.txt", reference)
    found = {v.what.split(":")[0]: v for v in verdicts("2D-SW-1", tmp_path)}
    assert {name: v.passed for name, v in found.items()} == {
        "D2_Al_50": True, "D2_Fe_100": None, "D2_Fe_200": None,
    }  # fmt: skip
    assert "taken from this reference" in found["D2_Fe_100"].required


def test_the_toolbox_runs_as_it_is_but_for_the_edge_it_shears(tmp_path, monkeypatch):
    vector = pytest.importorskip("ctsimu.primitives", reason="needs the extra ctsimu").Vector
    angles = {}

    def toolbox(test, *images, **more):
        turned = vector(1, 0, 0)
        turned.rotate_2D_xy(np.radians(3.0))
        angles[test] = np.degrees(np.arctan2(turned.y(), turned.x()))

    monkeypatch.setattr(suite, "render", Mock())  # the edges do not depend on the images
    monkeypatch.setattr(suite, "_toolbox", lambda: toolbox)
    monkeypatch.setattr(suite, "verdicts", lambda *_: [])
    for test in ("2D-WE-2", "2D-WE-1", "2D-DW-1"):
        (tmp_path / test).mkdir()
        suite._judged(test, tmp_path / test, lambda name: None)
    assert angles["2D-WE-2"] == pytest.approx(3.0, abs=1e-9)
    assert angles["2D-WE-1"] == angles["2D-DW-1"] == pytest.approx(2.996, abs=1e-3)
