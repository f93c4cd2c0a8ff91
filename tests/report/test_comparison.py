"""Volumes beside each other: cut at the same places, and nothing is compared that cannot be."""

import re
from dataclasses import replace

import numpy as np
import pytest

from twinct.geometry import Pose, VolumeGrid
from twinct.report import Compared, Comparison, cross_sections
from twinct.report.comparison import flat
from twinct.report.data import PLANES
from twinct.report.same_planes import layer_of, planes_through, section_at

BOX = np.array([[-25.0, -35.0, -45.0], [30.0, 35.0, 50.0]])


def in_box(grid):
    """A box of bone that is off the middle."""
    centres = np.stack(np.meshgrid(*grid.axes()[::-1], indexing="ij")[::-1], axis=-1)
    points = grid.world_from_grid.apply(centres)
    return np.all((points > BOX[0]) & (points < BOX[1]), axis=-1).astype("f4")


def ramp(grid):
    """The world's x + 1000 y + 10^6 z in each voxel."""
    centres = np.stack(np.meshgrid(*grid.axes()[::-1], indexing="ij")[::-1], axis=-1)
    return grid.world_from_grid.apply(centres) @ [1.0, 1e3, 1e6]


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
    for name, section in cut(finer, planes, ramp).items():
        normal = PLANES[name]
        kept = [n for n in range(3) if n != normal]
        assert section.reconstruction.shape == tuple(finer.shape[n] for n in kept)
        left, right, bottom, top = section.extent_mm
        x = left + (np.arange(section.reconstruction.shape[1]) + 0.5) * 2
        y = bottom + (np.arange(section.reconstruction.shape[0]) + 0.5) * 2
        weights = np.array([1e6, 1e3, 1.0])  # of z, y, x
        across = x * weights[kept[1]] + y[:, None] * weights[kept[0]]
        place = (section.reconstruction - across) / weights[normal]
        assert np.ptp(place) < 0.1, "single precision"
        # Its own plane, by half a voxel at most from the first's.
        assert place.mean() == pytest.approx(planes[name].place_mm, abs=1.0 + 0.1)
        assert right == pytest.approx(x[-1] + 1) and top == pytest.approx(y[-1] + 1)


def test_a_grid_that_is_turned_shows_its_nearest_voxels():
    planes = planes_of(VolumeGrid((20, 20, 20), 5.0))
    turned = VolumeGrid((24, 24, 24), 4.0, Pose.from_euler((3, 0, 0), (0, 0, 30)))
    section = cut(turned, planes, lambda grid: ramp(grid) % 1e6 % 1e3)["axial"]
    inside = np.isfinite(section.reconstruction)
    # A square turned by 30 degrees fills 1 / (sin + cos)^2 of its bounds.
    assert inside.mean() == pytest.approx(1 / (0.5 + 0.75**0.5) ** 2, abs=0.02)
    assert not section.roi[~inside].any()
    left, right, _, _ = section.extent_mm
    x = left + (np.arange(inside.shape[1]) + 0.5) * (right - left) / inside.shape[1]
    off = np.where(inside, section.reconstruction - x, 0.0)
    off[np.abs(off) > 500] -= 1000  # x below 0
    assert np.abs(off).max() <= 4 / 2**0.5 + 1e-3, "half the diagonal of a voxel"


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
    slices = {**report.slices, "axial": None}
    seconds = {**report.metrics["seconds"], "xray": 90.2}
    changes = {"image": better, "slices": slices, "seconds": seconds}
    second = compared(report, "<b>", **changes)
    html = Comparison((compared(report, "a"), second)).render()
    addresses = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert len(addresses) == 3 and all(a.startswith("data:image/png;base64,") for a in addresses)
    assert "<script" not in html and "<b>" not in html and "&lt;b&gt;" in html
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert f"SSIM {image['ssim']:.3f} {image['ssim'] + 0.1:.3f} (+0.100)" in words
    assert f"PSNR {image['psnr_db']:.1f} – dB" in words
    assert "X-ray projections 80.2 s 90.2 s (+10.0 s)" in words
    assert "None: the scenarios are the same." in words
    error = report.metrics["pose_error"]["source"]["position_mm"]["max"]
    assert f"source, position, max {error:.3f} {error:.3f} (=)" in words


def test_what_cannot_be_compared_is_said_and_has_no_difference(report):
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
        "b and a image different specimens",
        "b and a have different grids",
        "b and a were made by twinct 0.1.0b and ",
        "c and a are relative to different attenuations, 0.05 and 0.043",
    ):
        assert part in said
    html = found.render()
    assert "truth of a" not in html, "in the picture only"
    words = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert f"SSIM {image['ssim']:.3f} {image['ssim'] - 0.1:.3f} {image['ssim']:.3f} (=)" in words
