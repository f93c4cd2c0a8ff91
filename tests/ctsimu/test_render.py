"""Rendering with the real engine: against formulas, and the same bytes after an interruption."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh

from twinct.core.errors import FolderInUseError, ScanExistsError, SpecimenError
from twinct.core.files.lock import sole_owner
from twinct.ctsimu import Options, load_ctsimu, render
from twinct.ctsimu.camera import Camera
from twinct.ctsimu.scene import Sample
from twinct.ctsimu.solids import Solids
from twinct.ctsimu.writing import material_entry, quantity, vector
from twinct.geometry import Pose
from twinct.specimen import BuiltPart
from twinct.specimen import material as substance
from twinct.specimen.surface import refined
from twinct.xray.paths import PathRenderer

PATH_MM = 0.01
"""gVXR's path lengths through faces that are refined."""
QUICK = Options(samples=1)


def contents(folder):
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir())}


def noisy(data):
    data["detector"] |= {"noise": {"snr_at_imax": quantity(100)}, "image_lag": quantity(0.2)}
    data["acquisition"] |= {"flat_field": {"number": 2}, "dark_field": {"number": 1}}
    return data


def test_middle_pixels_follow_beer_lambert_and_the_free_beam_the_distance(data, write, tmp_path):
    render(load_ctsimu(write(data)), tmp_path / "out", QUICK)
    image = tifffile.imread(tmp_path / "out" / "small_0000.tif").astype(float)
    assert image.shape == (16, 24)
    mu = substance("Al").mu_per_mm(80.0) * 2.6989 / substance("Al").density_g_cm3
    ray = np.array([400.0, 1.0, 1.0])  # to the four pixels around the middle
    expected = 60000 * np.exp(-mu * 10 * np.linalg.norm(ray) / 400)
    np.testing.assert_allclose(image[7:9, 11:13], expected, atol=60000 * mu * PATH_MM)
    far = np.array([400.0, 23.0, 15.0])
    fall = (np.linalg.norm(ray) / np.linalg.norm(far)) ** 3
    np.testing.assert_allclose(image[[0, 0, -1, -1], [0, -1, 0, -1]], 60000 * fall, atol=1)


def test_row_0_is_the_top_and_column_0_the_left(data, write, tmp_path):
    position = data["samples"][0]["position"]
    position["center"] = vector([0, 8, 6], "uvw", "mm")  # stage v is world y: left in the image
    render(load_ctsimu(write(data)), tmp_path / "out", QUICK)
    image = tifffile.imread(tmp_path / "out" / "small_0000.tif").astype(float)
    rows, columns = np.nonzero(image < 50000)
    assert rows.mean() < 7.5 - 4 and columns.mean() < 11.5 - 6


def test_two_do_not_render_into_one_folder(data, write, tmp_path):
    scenario, out = load_ctsimu(write(data)), tmp_path / "out"
    out.mkdir()
    with sole_owner(out / "twinct.lock"), pytest.raises(FolderInUseError, match="is using this"):
        render(scenario, out, QUICK, resume=True)
    assert list(out.iterdir()) == []


def test_interrupted_rendering_goes_on_to_the_same_bytes(data, write, tmp_path):
    scenario = load_ctsimu(write(noisy(data)))
    out = tmp_path / "out"
    render(scenario, out, QUICK)
    whole = contents(out)
    for name in ("small_flat_0001.tif", "small_0001.tif", "small_0002.tif", "small_metadata.json"):
        (out / name).unlink()
    with pytest.raises(ScanExistsError, match="--resume"):
        render(scenario, out, QUICK)
    steps: list[int] = []
    render(scenario, out, QUICK, resume=True, step=lambda: steps.append(1))
    assert contents(out) == whole and len(steps) == 3
    with pytest.raises(ScanExistsError, match="other options"):
        render(scenario, out, Options(samples=1, seed=1), resume=True)


def test_a_rendering_is_known_after_a_resumption_that_was_cut_short(
    data, write, tmp_path, monkeypatch
):
    scenario, out = load_ctsimu(write(data)), tmp_path / "out"
    render(scenario, out, QUICK)
    whole = contents(out)

    def cut_short(path, text, **_):
        path.write_bytes(text[:3].encode())
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "write_text", cut_short)
        render(scenario, out, QUICK, resume=True)
    assert contents(out) == whole


def test_frame_does_not_depend_on_the_frames_before(data, write):
    # The bar swings towards the source and away; two samples overlap.
    data["samples"][0]["scaling_factor"]["r"] = quantity(12.0)
    iron = json.loads(json.dumps(data["samples"][0])) | {"name": "iron", "material_id": "Fe"}
    iron["scaling_factor"] = {axis: quantity(0.5) for axis in "rst"}
    data["samples"].append(iron)
    data["acquisition"] |= {"stop_angle": quantity(200.0, "deg"), "number_of_projections": 5}
    scenario = load_ctsimu(write(data))
    with Camera(1) as camera:
        course = [camera.expose(scenario.frame(index)) for index in range(5)]
    for index in (1, 2, 4):
        with Camera(1) as camera:
            assert (camera.expose(scenario.frame(index)) == course[index]).all()


def test_sample_at_the_source_is_refused(data, write):
    data["samples"][0]["position"]["center"]["u"] = quantity(-200.0, "mm")
    data["samples"][0]["scaling_factor"] = {axis: quantity(5.0) for axis in "rst"}
    scenario = load_ctsimu(write(data))
    with Camera(1) as camera, pytest.raises(SpecimenError, match="'cube' comes within .* of the s"):
        camera.expose(scenario.frame(0))


def test_files_of_other_names_stay_and_the_same_name_is_refused(data, write, tmp_path):
    scenario, out = load_ctsimu(write(data)), tmp_path / "out"
    out.mkdir()
    others = ["notes.txt", "small_2_0000.tif", "small_bone_flat.tif", "large_0000.tif"]
    for name in others:
        (out / name).write_text("mine")
    # What a rendering leaves that failed before its first image.
    (out / "small_rendering.json").write_text('{"digest": "of another"}')
    render(scenario, out, QUICK)
    assert {(out / name).read_text() for name in others} == {"mine"}
    (out / "small_rendering.json").write_text("not JSON")
    with pytest.raises(ScanExistsError, match="other options"):
        render(scenario, out, QUICK, resume=True)
    (out / "small_rendering.json").unlink()
    with pytest.raises(ScanExistsError, match="from elsewhere"):
        render(scenario, out, QUICK)


def test_noise_lag_and_averages(data, write, tmp_path):
    data = noisy(data)
    data["acquisition"] |= {"frame_average": 4, "stop_angle": quantity(0.0, "deg")}
    data["acquisition"]["flat_field"] |= {"frame_average": 25}
    render(load_ctsimu(write(data)), tmp_path / "out", QUICK)
    noise = [
        tifffile.imread(tmp_path / "out" / f"small_flat_000{i}.tif").astype(float) for i in (0, 1)
    ]
    difference = (noise[0] - noise[1]) / np.sqrt(2)
    # 384 pixels: their spread is known to 1 / sqrt(2 * 384) = 3.6 %; the rim gets 1 % less light.
    assert difference.std() == pytest.approx(60000 / 100 / 5, rel=0.12)
    assert (tifffile.imread(tmp_path / "out" / "small_dark.tif") == 0).all()


def test_lag_leaves_a_share_of_the_image_before(data, write, tmp_path):
    data["samples"][0]["position"]["center"]["v"]["drifts"] = [{"value": [0, 0, 15], "unit": "mm"}]
    data["acquisition"]["stop_angle"] = quantity(0.0, "deg")
    path = write(data)
    render(load_ctsimu(path), tmp_path / "sharp", QUICK)
    data["detector"]["image_lag"] = quantity(0.2)
    data["acquisition"]["frame_average"] = 2
    write(data)
    render(load_ctsimu(path), tmp_path / "lagging", QUICK)
    before, after = (
        tifffile.imread(tmp_path / "sharp" / f"small_{i:04d}.tif").astype(float) for i in (1, 2)
    )
    seen = tifffile.imread(tmp_path / "lagging" / "small_0002.tif")
    # Of the two frames averaged the first holds 0.2, the second 0.04 of what was before.
    np.testing.assert_allclose(seen, after + 0.12 * (before - after), atol=1.0)


def test_bad_pixels_binning_and_correction(data, write, tmp_path):
    bad = np.full((16, 24), -1, "<i2")
    bad[2, 3] = 777
    bad.tofile(tmp_path / "bad.raw")
    data["detector"]["bad_pixel_map"] = {"file": {"value": "bad.raw"}, "type": "int16"}
    path = write(data)
    render(load_ctsimu(path), tmp_path / "a", QUICK)
    assert tifffile.imread(tmp_path / "a" / "small_0000.tif")[2, 3] == 777
    data["detector"]["bad_pixel_map"] = None
    data["acquisition"] |= {
        "pixel_binning": {"u": 2, "v": 4},
        "flat_field": {"number": 1, "ideal": True, "correction": True},
    }
    write(data)
    render(load_ctsimu(path), tmp_path / "b", QUICK)
    image = tifffile.imread(tmp_path / "b" / "small_0000.tif")
    assert image.shape == (4, 12) and image[0, 0] == 60000
    assert json.loads((tmp_path / "b" / "small_metadata.json").read_text())["output"][
        "projections"
    ]["flat_field"]["projections_corrected"]


def test_room_full_of_water_attenuates_around_the_sample(data, write):
    data["materials"].append(material_entry("Water", 1.0, {"H2O": 1.0}))
    free = Camera(1).expose(load_ctsimu(write(data)).frame(0), samples_in=False)
    data["environment"]["material_id"] = "Water"
    scenario = load_ctsimu(write(data))
    mu = substance("water").mu_per_mm(80.0)
    with Camera(1) as camera:
        wet = camera.expose(scenario.frame(0), samples_in=False)
        both = camera.expose(scenario.frame(0))
    # Our water's rounded mass fractions differ from H2O's by 2e-4 in mu; there are 7.3 of them.
    np.testing.assert_allclose(wet[8, 12] / free[8, 12], np.exp(-mu * 400.0025), rtol=2e-3)
    displaced = np.exp(-10 * (substance("Al").mu_per_mm(80.0) * 2.6989 / 2.699 - mu))
    np.testing.assert_allclose(both[8, 12] / wet[8, 12], displaced, rtol=1e-3)


def test_where_two_samples_overlap_the_later_one_counts(data, write):
    iron = json.loads(json.dumps(data["samples"][0])) | {"name": "iron", "material_id": "Fe"}
    iron["scaling_factor"] = {axis: quantity(0.5) for axis in "rst"}
    data["samples"].append(iron)
    scenario = load_ctsimu(write(data))
    solids = Solids().of(scenario.frame(0).samples, np.zeros(3))
    assert [mesh.volume for _, mesh in solids] == pytest.approx([1000 - 125, 125])
    data["samples"].reverse()
    solids = Solids().of(load_ctsimu(write(data)).frame(0).samples, np.zeros(3))
    assert [body.name for body, _ in solids] == ["cube"]


def test_open_surface_is_refused(data, write, tmp_path):
    path = write(data)
    cube = trimesh.creation.box((10, 10, 10))
    cube.update_faces(np.arange(11))
    cube.export(tmp_path / "cube.stl")
    with pytest.raises(SpecimenError, match=r"cube.stl is not a closed surface: 3 of its edges"):
        render(load_ctsimu(path), tmp_path / "out", QUICK)


def test_long_faces_along_the_beam_are_refined(data, write):
    # gVXR takes the distance to the source as linear over a triangle.
    bar = trimesh.creation.box((100, 10, 10))
    scenario = load_ctsimu(write(data))
    frame = scenario.frame(0)
    pose = Pose([100.0, 7.0, 0.0], [0, 0, 0, 1.0])
    body = Sample("bar", frame.samples[0].file, (1, 1, 1), substance("Al"), pose)
    solids = Solids()
    solids._meshes[body.file, body.scale] = bar
    fine = solids.of([body], frame.view.source[0])[0][1]
    rays = frame.view.pixel_centres(0) - frame.view.source[0]
    rays /= rays[..., :1]
    # Enters through the face x = 50 or y = 2, leaves through x = 150 or y = 12.
    with np.errstate(divide="ignore"):
        near = np.maximum(50, 2 / rays[..., 1])
        far = np.minimum(150, 12 / rays[..., 1])
    exact = np.maximum(far - near, 0) * np.linalg.norm(rays, axis=-1) * (rays[..., 1] > 0)
    exact[np.abs(rays[..., 2]) * 150 > 5] = np.nan  # crosses top or bottom: not looked at
    off = {}
    for name, mesh in (("coarse", bar), ("fine", fine)):
        with PathRenderer([BuiltPart("step", substance("Al"), mesh)], frame.panel) as renderer:
            off[name] = np.nanmax(np.abs(renderer.render(frame.view, pose)[0] - exact))
    assert off["fine"] < PATH_MM < 1 < off["coarse"]
    assert refined(bar, 200.0) is bar
