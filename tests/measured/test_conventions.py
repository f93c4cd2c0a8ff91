"""Conventions that were stated wrongly are found by trying, up to a mirrored volume."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from twinct.measured.circle import Circle
from twinct.measured.conventions import MIRROR, SCALE, Candidate, try_conventions
from twinct.measured.description import read_description
from twinct.measured.views import ImageFacts

KINDS = {
    "reversed rotation": Candidate(reversed_order=True),
    "flipped rows": Candidate(rows=True),
    "transposed": Candidate(transposed=True),
    "offset sign": Candidate(offset_sign=True),
    "pixels for mm": Candidate(offset_px=True),
}
VIEWS, ROWS, COLUMNS = 60, 24, 30


def mirrored(candidate: Candidate, *, offset: bool) -> set[Candidate]:
    """Return the candidates that only mirror the volume of one, upright or sideways."""

    def other(**changes: bool) -> Candidate:
        return candidate._replace(**{k: not getattr(candidate, k) for k in changes})

    sideways = {"reversed_order": True, "columns": True} | ({"offset_sign": True} if offset else {})
    return {candidate, other(rows=True), other(**sideways), other(rows=True, **sideways)}


def balls_on(
    circle: Circle, rng: np.random.Generator, sizes: tuple[int, int, int] = (VIEWS, ROWS, COLUMNS)
) -> np.ndarray:
    """Return noisy line integrals of eight balls on a circle's panel, v up and u to the right."""
    geometry = circle.views(ImageFacts(*sizes)).geometry
    reach = sizes[2] / 2 * geometry.panel.pitch_u * circle.sod_mm / circle.sdd_mm
    total = np.zeros(sizes)
    for _ in range(8):
        radius = rng.uniform(0.08, 0.2) * reach
        centre = rng.uniform(-0.4, 0.4, 3) * reach
        for view in range(sizes[0]):
            ray = geometry.pixel_centres(view) - geometry.source[view]
            ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
            off = geometry.source[view] - centre
            inside = np.maximum((ray @ off) ** 2 - off @ off + radius**2, 0)
            total[view] += 2 * np.sqrt(inside) * 0.3 / reach
    return total + rng.normal(0, 0.01, total.shape)


def case(seed: int):
    """Return images and keys of a circle that are wrong in one way, and what is right."""
    rng = np.random.default_rng(seed)
    kind = list(KINDS)[seed % len(KINDS)]
    half_fan = np.radians(rng.uniform(5, 12))
    sdd = float(rng.uniform(500, 900) if seed % 2 else rng.uniform(60, 110))
    pitch = float(2 * sdd * np.tan(half_fan) / COLUMNS)
    if 0.9 < pitch < 1.1:  # pixels would be mm
        sdd, pitch = sdd / 2, pitch / 2
    offset = "offset" in kind or "pixels" in kind or seed % 2 == 0
    shift = float(rng.choice([-1, 1]) * rng.uniform(3, 5)) if offset else 0.0
    keys = {
        "kind": "circle",
        "sod_mm": sdd * float(rng.uniform(0.4, 0.7)),
        "sdd_mm": sdd,
        "pitch_mm": pitch,
        "angles": {"step": 360 / VIEWS},
        "rotates": "object",
        "direction": "clockwise",
        "rows": "up",
        "panel_offset_mm": [shift * pitch, 0.0],
    }
    told = read_description({"images": {"path": "-", "values": "line_integrals"}, "geometry": keys})
    images = balls_on(told.geometry, rng)
    if kind == "reversed rotation":
        keys["direction"] = "counterclockwise"
    elif kind == "flipped rows":
        images = images[:, ::-1]
    elif kind == "transposed":
        images = images.transpose(0, 2, 1)
    elif kind == "offset sign":
        keys["panel_offset_mm"] = [-shift * pitch, 0.0]
    else:
        keys["panel_offset_mm"] = [shift, 0.0]
    return images, keys, kind, offset


def check(seed, stored):
    images, keys, kind, offset = case(seed)
    ranking = try_conventions(read_description({"images": stored(images), "geometry": keys}))
    first = {tried.candidate for tried in ranking.classes[0]}
    right = KINDS[kind]
    assert right in first, (kind, ranking.notes)
    assert first <= mirrored(right, offset=offset), (kind, ranking.notes)
    assert MIRROR in ranking.notes and SCALE in ranking.notes


@pytest.mark.parametrize("seed", [0])
def test_a_wrong_convention_is_found(seed, stored):
    check(seed, stored)


@pytest.mark.tutorial
@pytest.mark.parametrize("seed", range(1, 20))
def test_wrong_conventions_are_found(seed, stored):
    check(seed, stored)


@pytest.mark.parametrize(
    ("axes", "right"),
    [((1, 0, 2), Candidate(views_rows=True)), ((2, 1, 0), Candidate(views_columns=True))],
)
def test_axes_exchanged_between_equal_counts_are_found(axes, right, stored):
    keys = {
        "kind": "circle",
        "sod_mm": 250.0,
        "sdd_mm": 400.0,
        "pitch_mm": 3.0,
        "angles": {"step": 15.0},
        "rotates": "object",
        "direction": "clockwise",
        "rows": "up",
    }
    told = read_description({"images": {"path": "-", "values": "line_integrals"}, "geometry": keys})
    images = balls_on(told.geometry, np.random.default_rng(3), (24, 24, 24))
    ranking = try_conventions(
        read_description({"images": stored(images.transpose(axes)), "geometry": keys})
    )
    first = {tried.candidate for tried in ranking.classes[0]}
    assert right in first, ranking.notes
    assert first <= mirrored(right, offset=False), ranking.notes


def test_what_is_right_stays_first(stored, circle, tmp_path):
    from ball_scan import ball_images, orbit

    ranking = try_conventions(
        read_description({"images": stored(ball_images(orbit())), "geometry": circle})
    )
    assert ranking.classes[0][0].candidate == Candidate()
    ranking.show(tmp_path / "tried.png")
    shown = Image.open(tmp_path / "tried.png").convert("L")
    assert np.ptp(np.asarray(shown)) > 200
    tops, sides = np.asarray(shown)[:4], np.asarray(shown)[:, [0, 1, -2, -1]]
    assert min(tops.min(), sides.min()) == 255, "titles are cut off"


def test_the_command_tries_and_imports_nothing(stored, circle, tmp_path, capsys):
    import yaml
    from ball_scan import ball_images, orbit

    from twinct.cli import run_command

    file, out = tmp_path / "scan.yaml", tmp_path / "out"
    source = {"images": stored(ball_images(orbit())), "geometry": circle}
    file.write_text(yaml.safe_dump(source))
    assert run_command(["import", str(file), "--out", str(out), "--try"]) == 0
    assert "%: as stated" in capsys.readouterr().out
    assert [path.name for path in out.iterdir()] == ["tried.png"]
    assert run_command(["import", str(file), "--out", str(out)]) == 0
    assert run_command(["import", str(tmp_path / "a.mcap"), "--out", str(out), "--try"]) == 2
