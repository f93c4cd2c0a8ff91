"""Volumes beside each other: cut at the same places, and nothing is compared that cannot be."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from twinct.geometry import Pose, VolumeGrid
from twinct.report import Compared, Comparison, cross_sections, figures
from twinct.report.comparison import flat
from twinct.report.data import PLANES
from twinct.report.same_planes import layer_of, planes_through, section_at

BOX = np.array([[-25.0, -35.0, -45.0], [30.0, 35.0, 50.0]])


def in_box(grid):
    """A box of bone that is off the middle."""
    centres = np.stack(np.meshgrid(*grid.axes()[::-1], indexing="ij")[::-1], axis=-1)
    points = grid.world_from_grid.apply(centres)
    return np.all((points > BOX[0]) & (points < BOX[1]), axis=-1).astype("f4")


def along(axis):
    """Volumes of the world's x, y or z, mm."""

    def values(grid):
        centres = np.stack(np.meshgrid(*grid.axes()[::-1], indexing="ij")[::-1], axis=-1)
        return grid.world_from_grid.apply(centres)[..., axis]

    return values


def planes_of(grid):
    return planes_through(grid, BOX, Pose.identity(), lambda layer: bool(in_box(layer).any()))


def cut(grid, planes, values=in_box):
    layers = {name: layer_of(plane, grid) for name, plane in planes.items()}
    return {
        name: layer
        and section_at(
            planes[name], values(grid), grid, layer, in_box(layer), np.ones(layer.shape, bool)
        )
        for name, layer in layers.items()
    }


@pytest.mark.parametrize(
    "grid",
    [
        VolumeGrid((22, 21, 20), (4.0, 5.0, 6.0), Pose.from_euler((1, 2, 3), (0, 0, 0))),
        VolumeGrid((30, 32, 34), 5.0, Pose.from_euler((0, 90, 0), (0, 0, 0))),  # middle misses
        VolumeGrid((22, 21, 20), 5.0, Pose.from_euler((1, 2, 3), (20, 0, 40))),
    ],
    ids=["shifted", "middle misses", "turned"],
)
def test_the_first_shows_the_slices_of_its_report(grid):
    report = cross_sections(in_box(grid), in_box(grid), np.ones(grid.shape, bool), grid)
    for name, section in cut(grid, planes_of(grid)).items():
        for ours, theirs in zip(section[:3], report[name][:3], strict=True):
            np.testing.assert_array_equal(ours, theirs, err_msg=name)
        np.testing.assert_allclose(section.extent_mm, report[name].extent_mm, atol=1e-9)
        assert section[4:] == report[name][4:]


def test_other_grids_are_cut_at_the_same_place_in_their_own_voxels():
    first = VolumeGrid((20, 20, 20), 5.0)
    planes = planes_of(first)
    finer = VolumeGrid((60, 50, 40), 2.0, Pose.from_euler((7, -4, 3), (0, 0, 0)))
    for axis, edge in enumerate(finer.size_mm / finer.shape_xyz):
        for name, section in cut(finer, planes, along(axis)).items():
            normal = 2 - PLANES[name]
            left, right, bottom, top = section.extent_mm
            rows, columns = section.reconstruction.shape
            x = left + (np.arange(columns) + 0.5) * (right - left) / columns
            y = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
            if axis == normal:  # its own plane, by half a voxel at most from the first's
                wanted, off = planes[name].place_mm, edge / 2
                assert np.ptp(section.reconstruction) == 0
            else:
                up = axis == max(set(range(3)) - {normal})
                wanted, off = (y[:, None] if up else x), 0.0
            assert np.abs(section.reconstruction - wanted).max() <= off + 1e-4, "single precision"


def test_a_grid_that_is_turned_shows_its_nearest_voxels():
    planes = planes_of(VolumeGrid((20, 20, 20), 5.0))
    turned = VolumeGrid((24, 24, 24), 4.0, Pose.from_euler((3, 0, 0), (0, 0, 30)))
    section = cut(turned, planes, along(0))["axial"]
    inside = np.isfinite(section.reconstruction)
    # A square turned by 30 degrees fills 1 / (sin + cos)^2 of its bounds.
    assert inside.mean() == pytest.approx(1 / (0.5 + 0.75**0.5) ** 2, abs=0.02)
    assert not section.roi[~inside].any()
    left, right, _, _ = section.extent_mm
    x = left + (np.arange(inside.shape[1]) + 0.5) * (right - left) / inside.shape[1]
    off = np.nanmax(np.abs(section.reconstruction - x))
    assert 1.0 < off <= 4 / 2**0.5 + 1e-3, "half the diagonal of a voxel"


def test_a_plane_that_passes_a_grid_shows_nothing():
    planes = planes_of(VolumeGrid((20, 20, 20), 5.0))
    above = VolumeGrid((10, 20, 20), 5.0, Pose.from_euler((0, 0, 60), (0, 0, 0)))
    found = cut(above, planes)
    assert found["axial"] is None and found["coronal"] is not None


def compared(report, label, **changes):
    own = {
        "label": label,
        "path": f"out/{label}",
        "scenario": report.scenario,
        "metrics": report.metrics,
        "image": report.metrics["image"],
        "in_words": report.scenario.reconstruction.in_words,
        "seconds": report.metrics["seconds"],
        "slices": report.slices,
        "mu_reference": report.mu_reference,
        "reference": "bone",
        "truth": "a skull",
    }
    return Compared(**own | changes)


def with_keys(scenario, **changes):
    section = scenario.reconstruction.model_copy(update=changes)
    return scenario.model_copy(update={"reconstruction": section})


def test_only_keys_that_differ_are_told(report):
    other = with_keys(report.scenario, iterations=7, relaxation=0.1)
    found = Comparison((compared(report, "a"), compared(report, "b", scenario=other)))
    was = report.scenario.reconstruction
    assert found.keys == {
        "reconstruction.iterations": (was.iterations, 7),
        "reconstruction.relaxation": (was.relaxation, 0.1),
    }
    assert found.notes == []
    told = {"parts": [{"at": [1, 2]}, {"at": []}], "table": None}
    assert flat(told) == {"parts.0.at": [1, 2], "parts.1.at": [], "table": None}


def test_the_page_is_whole_and_says_differences(report):
    image = report.metrics["image"]
    better = {**image, "ssim": image["ssim"] + 0.1, "psnr_db": None}
    sagittal = {"sagittal": report.slices["sagittal"]}
    seconds = {**report.metrics["seconds"], "xray": 90.2}
    first = compared(report, "a", slices=sagittal)
    second = replace(first, label="<b>", image=better, seconds=seconds)
    html = Comparison((first, second)).render()
    addresses = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert len(addresses) == 1 and all(a.startswith("data:image/png;base64,") for a in addresses)
    assert "<script" not in html and "<b>" not in html and "&lt;b&gt;" in html
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert f"SSIM {image['ssim']:.3f} {image['ssim'] + 0.1:.3f} (+0.100)" in words
    assert f"PSNR {image['psnr_db']:.1f} – dB" in words
    assert "X-ray projections 80.2 s 90.2 s (+10.0 s)" in words
    assert "No scenario key differs." in words
    error = report.metrics["pose_error"]["source"]["position_mm"]["max"]
    assert f"source, position, max {error:.3f} {error:.3f} (=)" in words


def test_the_page_shows_figures_and_slices_first_and_folds_many_keys(report, monkeypatch):
    monkeypatch.setattr("twinct.report.comparison._pictures", lambda _: [])
    few = compared(report, "b", scenario=with_keys(report.scenario, iterations=7))
    gantry = report.scenario.with_({"cell.kind": "gantry", "uncertainty.seed": 5})
    pages = [
        Comparison((compared(report, "a"), one))
        for one in (few, compared(report, "c", scenario=gantry))
    ]
    assert len(pages[1].keys) > 12
    for page in pages:
        html = page.render()
        order = ["Image figures", "Slices", "Pose errors", "Time", "Scenario keys that differ"]
        places = [html.index(f">{title}") for title in order]
        assert places == sorted(places)
    assert "<details open>" in pages[0].render()
    assert "<details>" in pages[1].render()


def test_a_gantry_has_no_keys_of_motion(report):
    gantry, other = (
        report.scenario.with_({"cell.kind": "gantry", "motion.scheme": scheme})
        for scheme in ("planned", "reactive")
    )
    found = Comparison(
        (compared(report, "a", scenario=gantry), compared(report, "b", scenario=other))
    )
    assert found.keys == {}


def test_pictures_share_extent_and_windows(report):
    """Only what is no picture of a section may differ where a column is left empty."""
    section = report.slices["sagittal"]
    looks = figures.windows([section], report.mu_reference)
    columns = {"a": section, "b": section, "c": section, "d": section}
    whole, gap = (
        np.asarray(Image.open(io.BytesIO(figures.side_by_side(which, "truth", looks).content)))
        for which in (columns, columns | {"b": None})
    )
    assert whole.shape == gap.shape, "two bands: the truth and three, then the fourth"
    changed = np.any(whole != gap, axis=(0, 2))
    column = whole.shape[1] / 4
    assert changed.any() and not changed[: int(1.9 * column)].any()
    assert not changed[int(3.2 * column) :].any()
    # What lies outside a grid is neither black nor white.
    wider = section._replace(extent_mm=tuple(2 * edge for edge in section.extent_mm))
    page = figures.side_by_side({"a": section, "b": wider}, "truth", looks).content
    outside = np.array([int(figures._OUTSIDE[i : i + 2], 16) for i in (1, 3, 5)])
    share = np.all(np.asarray(Image.open(io.BytesIO(page))) == outside, axis=-1).mean()
    assert 0.2 < share < 0.6


def test_what_cannot_be_compared_is_said_and_has_no_difference(report, monkeypatch):
    monkeypatch.setattr("twinct.report.comparison._pictures", lambda _: [])
    first, image = compared(report, "a"), report.metrics["image"]
    worse = {**image, "ssim": image["ssim"] - 0.1}
    grid = report.scenario.reconstruction.grid.model_copy(update={"voxel_mm": 1.0})
    metrics = {**report.metrics, "twinct_version": "0.1.0b"}
    changes = {"image": worse, "scenario": with_keys(report.scenario, grid=grid)}
    second = compared(report, "b", truth="a hand", metrics=metrics, **changes)
    found = Comparison((first, second, replace(first, label="c", mu_reference=0.05)))
    said = "\n".join(found.notes)
    assert len(found.notes) == 4
    for part in (
        "b and a show different specimens",
        "b and a have different grids",
        "b and a were made by twinct 0.1.0b and ",
        "c and a are relative to different attenuations, 0.05 and 0.043",
    ):
        assert part in said
    html = found.render()
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert f"SSIM {image['ssim']:.3f} {image['ssim'] - 0.1:.3f} {image['ssim']:.3f} (=)" in words
