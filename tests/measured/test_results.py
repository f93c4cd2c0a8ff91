"""Volumes of a measured scan: any algorithm, figures without a truth, and none that needs one."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from ball_scan import BALL, MU, PITCH, RADIUS, ROWS, SDD, SOD, VIEWS, ball_images, orbit

from twinct.cli import run_command
from twinct.core.errors import InputError, ScanExistsError
from twinct.recon.algorithms import algorithms
from twinct.runs import StoredReconstruction, load_scan, reconstruct_run, run, simulate
from twinct.runs.cures import cures_of
from twinct.scan import Imported

pytestmark = pytest.mark.usefixtures("measured")

GRID = {"voxels": [40, 40, 24], "voxel_mm": 1.0}
WITHOUT = {"rtk_sart", "prior_tv", "known_components"}
"""Algorithms that need another package, a prior or an implant."""


@pytest.fixture
def measured(imported, stored, circle):
    """Folder of an imported scan of the ball, with a little noise."""
    images = ball_images(orbit()) + np.random.default_rng(2).normal(0, 0.002, (VIEWS, ROWS, 26))
    source = {"name": "ball", "images": stored(images), "geometry": circle, "grid": GRID}
    return imported(source)[1].folder


def test_an_import_is_no_simulation(measured):
    """Nothing is made up: no gantry, no beam, and no geometry but the stated one."""
    scan = load_scan(measured)
    assert isinstance(scan.provenance, Imported) and scan.provenance.files
    assert scan.geometries == ("stated",) and scan.reported.name == "stated"
    assert scan.settings.source is None and scan.settings.specimen is None
    assert scan.photons is None and not scan.provenance.noiseless
    for name in ("scenario", "commanded", "executed", "joints", "clearance_mm"):
        with pytest.raises(InputError, match="is an imported scan"):
            getattr(scan, name)
    with pytest.raises(InputError, match="unknown geometry 'executed'; choose from stated"):
        scan.geometry("executed")
    found = sorted(p.name for p in measured.iterdir())
    assert found == ["imported.png", "scan.zarr", "scenario.yaml"]
    part = scan.of_views(range(1, VIEWS, 2))
    np.testing.assert_array_equal(part.geometry().source, scan.geometry().source[1::2])


def test_a_correction_that_needs_the_beam_says_so(measured):
    nmar = ["reconstruction.algorithm=fdk", "reconstruction.metal={method: nmar, metal: titanium}"]
    with pytest.raises(InputError, match="needs the beam of the scan, which is not known"):
        reconstruct_run(measured, nmar)


def test_causes_in_the_geometry_come_first_with_their_commands(measured):
    beam, roll, offset = (
        cures_of(load_scan(measured), [name])[0] for name in ("beam", "roll", "offset")
    )
    assert cures_of(load_scan(measured), ["beam", "roll", "offset"]) == [roll, offset, beam]
    assert "twinct calibrate circle" in roll and "twinct import --try" in offset


@pytest.mark.tutorial
def test_every_algorithm_finds_the_ball(measured):
    scan = load_scan(measured)
    grid = scan.settings.reconstruction.volume_grid
    x, y, z = grid.axes()
    off = (x - BALL[0]) ** 2 + ((y - BALL[1]) ** 2)[:, None] + ((z - BALL[2]) ** 2)[:, None, None]
    inside = off < (RADIUS - 1.5) ** 2
    for name in algorithms():
        if name in WITHOUT:
            continue
        keys = [f"reconstruction.algorithm={name}"]
        if name == "sirt":  # it takes many more passes than all others
            keys.append("reconstruction.iterations=40")
        made = reconstruct_run(measured, keys)
        assert 0.35 < made.volume.array[inside].mean() / MU < 1.2, name
        assert made.figures.residual_rel < 0.35, name
        assert made.figures.edge_width_mm < 4, name
    told = json.loads((measured / "metrics.json").read_text())
    assert set(told["reconstructions"]) == set(algorithms()) - WITHOUT


def test_report_has_no_figure_that_needs_a_truth(measured):
    made = reconstruct_run(measured, ["reconstruction.algorithm=fdk"], halves=True)
    page = (measured / "report.html").read_text(encoding="utf-8")
    shown = re.sub(r"<pre>.*?</pre>|data:image[^\"]*", "", page, flags=re.DOTALL)
    assert "There is no truth" in shown and f"{100 * made.figures.residual_rel:.2f}" in shown
    assert not re.search("RMSE|SSIM|PSNR|bone", shown)
    text = (measured / "metrics.json").read_text()
    assert not re.search("rmse|ssim|psnr|pose_error", text)


@pytest.mark.tutorial
def test_halves_tell_the_noise(measured, imported, stored, circle):
    """Twice the noise of the images gives twice the noise of the halves."""
    clean = np.exp(-ball_images(orbit(120)))
    noise = np.random.default_rng(3).normal(0, 0.03, clean.shape)
    turn = circle | {"angles": {"step": 3.0}}
    found = []
    for times in (1, 2):
        section = stored(clean * np.exp(times * noise), "transmissions")
        folder = imported({"images": section, "geometry": turn, "grid": GRID})[1].folder
        made = reconstruct_run(folder, ["reconstruction.algorithm=fdk"], halves=True)
        found.append(made.figures.noise_per_mm)
    assert found[1] / found[0] == pytest.approx(2, rel=0.1)


def test_a_wrong_view_stands_out(imported, stored, circle):
    images = ball_images(orbit())
    images[7] = np.roll(images[7], 2, axis=1)
    folder = imported({"images": stored(images), "geometry": circle, "grid": GRID})[1].folder
    judged = reconstruct_run(folder, ["reconstruction.algorithm=fdk"]).figures
    assert int(np.argmax(judged.residual_by_view)) == 7


def test_a_changed_volume_is_found(measured):
    from twinct.runs import verify

    made = reconstruct_run(measured, ["reconstruction.algorithm=fdk"])
    assert verify(measured).problems == ()
    file = made.path / "volume.nii"
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(content)
    assert "volume.nii differs from the file written for fdk" in "".join(verify(measured).problems)


def test_names_are_free_taken_or_refused(measured):
    fdk = ["reconstruction.algorithm=fdk"]
    assert [reconstruct_run(measured, fdk).name for _ in range(2)] == ["fdk", "fdk"]
    hann = [*fdk, "reconstruction.window=hann"]
    assert reconstruct_run(measured, hann).name == "fdk-2"
    with pytest.raises(ScanExistsError, match="already holds this reconstruction; omit --as"):
        reconstruct_run(measured, fdk, name="mine")
    with pytest.raises(ScanExistsError, match="another reconstruction"):
        reconstruct_run(measured, [*fdk, "reconstruction.nonnegative=true"], name="fdk")
    with pytest.raises(InputError, match="only keys of reconstruction"):
        reconstruct_run(measured, ["source.mas=2"])
    with pytest.raises(InputError, match="unknown geometry 'mine'"):
        reconstruct_run(measured, fdk, geometry="mine")


def test_nothing_is_simulated_for_an_unknown_specimen(measured, tmp_path):
    with pytest.raises(InputError, match="is an imported scan: it has no scenario"):
        simulate(load_scan(measured).scenario)
    with pytest.raises(InputError, match="specimen"):
        run(measured / "scenario.yaml", measured, link="local", resume=True)


def test_a_moved_folder_is_read(measured, tmp_path):
    moved = measured.rename(tmp_path / "elsewhere")
    scan = load_scan(moved)
    assert scan.geometry().sdd == pytest.approx(np.full(VIEWS, SDD))
    assert np.linalg.norm(scan.geometry().source, axis=1) == pytest.approx(np.full(VIEWS, SOD))
    assert scan.settings.detector.pixel_pitch_mm == (PITCH, PITCH)
    assert reconstruct_run(moved, ["reconstruction.algorithm=fdk"]).name == "fdk"


def test_the_command_line_imports_and_reconstructs(measured, stored, circle, tmp_path, capsys):
    import yaml

    from twinct.cli import run_command

    source = {"images": stored(ball_images(orbit())), "geometry": circle, "grid": GRID}
    (tmp_path / "scan.yaml").write_text(yaml.safe_dump(source))
    out = str(tmp_path / "out")
    assert run_command(["import", str(tmp_path / "scan.yaml"), "--out", out]) == 0
    assert run_command(["reconstruct", out, "--set", "reconstruction.algorithm=fdk"]) == 0
    told = capsys.readouterr()
    assert "source to axis 200 mm, to panel 300 mm, pitch 2 x 2 mm" in told.out
    assert "residual" in told.out and (tmp_path / "out" / "imported.png").is_file()


def test_report_judges_again_and_compare_shows_no_figure_of_a_truth(
    measured, monkeypatch, capfd, tmp_path
):
    monkeypatch.setattr("twinct.runs.reporting.write_report", lambda *_: None)
    fdk = reconstruct_run(measured, ["reconstruction.algorithm=fdk"], halves=True)
    judged = fdk.figures
    assert judged.residual_rel < judged.consistency_rel < 3 * judged.residual_rel
    coarse = {"voxels": [20, 20, 12], "voxel_mm": 2.0}
    reconstruct_run(measured, [f"reconstruction.grid={coarse}"], name="coarse")
    file = fdk.path / "reconstruction.json"
    told = json.loads(file.read_text())
    file.write_text(json.dumps(told | {"figures": told["figures"] | {"residual": 9.0}}))
    assert run_command(["report", str(measured)]) == 0
    assert "consistency" in capfd.readouterr().out
    assert StoredReconstruction.read(fdk.path).figures == judged

    page = tmp_path / "both.html"
    assert run_command(["compare", str(measured), "--out", str(page)]) == 0
    assert "fdk and coarse have different grids" in capfd.readouterr().err
    text = re.sub('data:image[^"]*', "", page.read_text(encoding="utf-8"))
    assert f"{100 * judged.consistency_rel:.2f}" in text and "edge width" in text
    assert not re.search("RMSE|SSIM|PSNR|bone|truth|[Pp]ose error|clearance", text)
    one = [str(fdk.path)]
    for folders, words in (
        (one, "1 volume: at least two"),
        ([*one, *one], "given twice"),
        ([*one, str(tmp_path)], "is not a measured scan"),
    ):
        assert run_command(["compare", *folders, "--out", str(page)]) == 2
        assert words in capfd.readouterr().err
    region = "evaluation.regions=[{name: it, shape: {kind: sphere, radius_mm: 9}}]"
    asked = ["--set", region, "--set", "evaluation.nps=[{region: it}]"]
    assert run_command(["report", str(measured), *asked]) == 2
    assert "has no truth" in capfd.readouterr().err
